"""An unknown tool, identified beside gain, offset and mounting of its sensor (docs/tool.md)."""
