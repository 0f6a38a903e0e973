"""The main jobs from a script, with the defaults of the command line.

Each takes what a user has at hand (a vessel's name or file; recordings as files, as DataFrames or
as read) and returns a record that prints as a short table. May import every room but the command
line. `diffsea` itself exports the names; this package holds none of its own, so that an audit
starts without JAX.
"""
