"""Missions: what a file asks of a vessel, run in closed loop and scored.

May import `identification` and what lies below it.
"""

from diffsea.missions.document import mission_of as mission_of
from diffsea.missions.document import read_mission as read_mission
from diffsea.missions.record import Mission as Mission
from diffsea.missions.running import MissionRun as MissionRun
from diffsea.missions.running import run as run
from diffsea.missions.scores import scores as scores
from diffsea.missions.studies.battery import Battery as Battery
from diffsea.missions.studies.battery import BatteryRun as BatteryRun
from diffsea.missions.studies.battery import battery_scores as battery_scores
from diffsea.missions.studies.battery import read_battery as read_battery
from diffsea.missions.studies.battery import run_battery as run_battery
