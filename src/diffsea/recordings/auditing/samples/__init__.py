"""Faults of a channel by itself: its clock, its rounding, wild values, values that were made up.

They are looked for before channels are compared with each other. May import the audit's findings,
edits and motion; exports nothing, for the audit alone calls it.
"""
