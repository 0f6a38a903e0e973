"""Missions: what a file asks of a vessel, run in closed loop and scored.

May import what the rest of `simulation` may, and `simulation` itself.
"""

from diffsea.simulation.mission.document import mission_of as mission_of
from diffsea.simulation.mission.document import read_mission as read_mission
from diffsea.simulation.mission.record import Mission as Mission
from diffsea.simulation.mission.running import MissionRun as MissionRun
from diffsea.simulation.mission.running import run as run
from diffsea.simulation.mission.scores import scores as scores
