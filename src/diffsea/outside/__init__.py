"""Where the package meets files that others wrote: documents, names, sizes, writing for good.

What the rooms above read from outside may be hostile. Here are the one loader of TOML and JSON, the
one place that makes names printable, the one that knows how large a file becomes when it is
expanded, the one durable write, and the folders for what is not finished. Imports nothing of the
package but its errors.
"""
