"""Vessels for other tools: Gazebo, ArduPilot, FMI, the Marine Systems Simulator.

May import `studies`, `simulation`, `vessel` and what lies below. One module writes one format;
`equations` says in plain numbers what a vessel's motion consists of, and names what it leaves out.
"""
