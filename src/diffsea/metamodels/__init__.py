"""Metamodels: what several trials of one kind of manoeuvre have in common.

Norrbin's equation of yaw, its identification from several trials, and the ideal zig-zag that it
predicts. Trials come from `diffsea.recordings`, the likelihood from `diffsea.identification`.
"""
