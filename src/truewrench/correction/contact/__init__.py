"""The contact wrench: what a sensor feels beyond its tool, and how well that is known (docs/contact.md)."""
