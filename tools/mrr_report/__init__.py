"""The report of one hammering run: data.py reads it, figures.py draws it, page.py writes it down."""
