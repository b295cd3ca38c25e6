"""Self-contained HTML reports, made from archives alone."""
