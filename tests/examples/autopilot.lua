-- A stand-in for ArduPilot Rover: runs examples/blueboat/trials.lua on a clock of 50 ms.
--
--     lua autopilot.lua SCRIPT NUMBER [EVENT SECONDS]
--
-- Mission item NUMBER is active from the start. EVENT: mode (the pilot chooses MANUAL), disarm, far
-- (the boat is 300 m away), lost (no position). Prints a line per override: ms, output, us, timeout;
-- then how it ended: time, mode, items done.

local script, number, event, at = arg[1], tonumber(arg[2]), arg[3], tonumber(arg[4] or "1e9") * 1000
local now, mode, armed, distance, position, done = 0, 10, true, 0, true, {}

local Clock = {} -- as the autopilot's unsigned integers: no plain numbers
Clock.__index = Clock
Clock.__sub = function(a, b)
  return setmetatable({value = a.value - b.value}, Clock)
end
function Clock:tofloat()
  return self.value + 0.0
end
function millis()
  return setmetatable({value = now}, Clock)
end

SRV_Channels = {}
function SRV_Channels:find_channel(func)
  return ({[73] = 2, [74] = 0})[func]
end
function SRV_Channels:set_output_pwm_chan_timeout(channel, pulse, timeout)
  assert(math.type(channel) == "integer" and math.type(pulse) == "integer")
  print(now, channel, pulse, timeout)
end
param = {}
function param:get(name) -- output 1 is reversed and its neutral is off
  local values = {SERVO1_TRIM = 1510.0, SERVO1_REVERSED = 1.0, SERVO3_REVERSED = 0.0}
  local usual = {TRIM = 1500.0, MIN = 1100.0, MAX = 1900.0}
  return values[name] or usual[name:match("_(%u+)$")]
end
gcs = {}
function gcs:send_text(severity, text)
  assert(math.type(severity) == "integer" and #text < 50)
end
arming = {}
function arming:is_armed()
  return armed
end
ahrs = {}
function ahrs:get_location()
  local place = {get_distance = function() return distance end}
  return position and place or nil
end
vehicle = {}
function vehicle:get_mode()
  return mode
end
function vehicle:set_mode(wanted)
  mode = wanted
  return true
end
function vehicle:nav_script_time()
  if mode ~= 10 or done[7] then
    return nil
  end
  return 7, number, 0.0, 0.0, 0, 0
end
function vehicle:nav_script_time_done(id)
  done[id] = true
end

local update = dofile(script)
for _ = 0, 6000 do
  if now >= at then
    if event == "mode" then mode = 0 end
    if event == "disarm" then armed = false end
    if event == "far" then distance = 300 end
    if event == "lost" then position = false end
  end
  local wait
  update, wait = update()
  now = now + wait
end
print("end", mode, done[7] and "done" or "not done")
