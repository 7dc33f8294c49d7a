"""How objects show themselves: one line, HTML, tables, and the door to pictures."""
