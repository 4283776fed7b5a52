"""Plans that determine an unknown tool: poses of gravity far apart, or a motion (docs/tool.md)."""
