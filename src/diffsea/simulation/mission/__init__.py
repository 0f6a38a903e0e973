"""Missions: what a file asks of a vessel, run in closed loop and scored.

May import what the rest of `simulation` may, and `simulation` itself.
"""

from diffsea.simulation.mission.battery import Battery as Battery
from diffsea.simulation.mission.battery import BatteryRun as BatteryRun
from diffsea.simulation.mission.battery import battery_scores as battery_scores
from diffsea.simulation.mission.battery import read_battery as read_battery
from diffsea.simulation.mission.battery import run_battery as run_battery
from diffsea.simulation.mission.document import mission_of as mission_of
from diffsea.simulation.mission.document import read_mission as read_mission
from diffsea.simulation.mission.record import Mission as Mission
from diffsea.simulation.mission.running import MissionRun as MissionRun
from diffsea.simulation.mission.running import run as run
from diffsea.simulation.mission.scores import scores as scores
