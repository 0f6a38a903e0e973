"""Pages of single commands, one module each; those of fits and diagnoses are beside this room.

May import what pages are made of: `report.page`, `report.plots`, `report.predictions`, words.
"""
