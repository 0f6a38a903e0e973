"""Where the package meets what is not its own: files that others wrote, disks, a cluster's workers.

What the rooms above read from outside may be hostile. Here are the one loader of TOML and JSON, the
one place that makes names printable, the one that knows how large a file becomes when it is
expanded, the one durable write, the folders for what is not finished, and the one place that hands
work to other machines. Imports nothing of the package but errors, progress and set-up.
"""
