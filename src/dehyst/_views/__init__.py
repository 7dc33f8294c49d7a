"""Views of objects: one line, HTML, tables, and plots."""
