"""Channels against each other by kinematics alone: heading and yaw rate, position and velocity.

A comparison says what a measured level should have become, a selection which causes part the two,
and a disagreement what that is a fault of. May import the audit's findings, edits, responses and
motion; exports nothing, for the audit alone calls it.
"""
