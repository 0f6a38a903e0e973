-- Open-loop trials for identification: ArduPilot Rover, two thrusters (SERVOn_FUNCTION 73 and 74).
--
-- It was checked against a stand-in for the autopilot, and HAS NOT RUN ON A BOAT. Try it first in
-- ArduPilot's simulator, then out of the water with the propellers off, then with somebody at the
-- remote control, on water without traffic.
--
-- Needs SCR_ENABLE = 1 and this file in APM/scripts. A mission item NAV_SCRIPT_TIME (42702) whose
-- first parameter is the number of a trial runs it, see trials.waypoints. It ends, and the outputs
-- are the autopilot's again, when
--   * the pilot chooses any other mode than AUTO, or disarms: at the next update, 50 ms
--   * this script ends or hangs: overrides of outputs expire by themselves after 300 ms
--   * the boat is further away from where the trial began than FARTHEST: then mode HOLD
--   * the position is lost, or its parameters are not there: then mode HOLD
--   * its time is over: then the mission goes on

local FARTHEST = 200 -- m
local TRIALS = { -- seconds, port and starboard as shares of full order
  {"acceleration", {{2, 0, 0}, {6, 0.5, 0.5}, {6, 1, 1}}},
  {"coasting", {{8, 1, 1}, {25, 0, 0}}},
  {"steady", {{20, 0.2, 0.2}, {20, 0.35, 0.35}, {20, 0.55, 0.55}, {20, 0.75, 0.75}, {20, 1, 1},
              {20, 0, 0}, {20, -0.35, -0.35}, {20, -0.7, -0.7}}},
  {"turning", {{6, 0.5, 0.5}, {15, 0.6, 0.2}, {15, 0.2, 0.6}, {12, 0.9, 0.4}, {12, 0.4, 0.9},
               {12, 0.4, 0}, {12, 0, 0.4}, {8, 0.3, -0.4}, {8, -0.4, 0.3}}},
  {"weaving", {{4, 0.5, 0.5}, {5, 0.7, 0.3}, {5, 0.3, 0.7}, {5, 0.7, 0.3}, {5, 0.3, 0.7},
               {5, 0.7, 0.3}, {5, 0.3, 0.7}, {5, 0.7, 0.3}, {5, 0.3, 0.7}, {10, 0.2, 0.5}}},
}

local AUTO, HOLD = 10, 4 -- modes of Rover
local WARNING, INFO = 4, 6 -- severities of messages
local LEFT, RIGHT = 73, 74 -- functions of outputs: throttle left and right
local EVERY, EXPIRES = 50, 300 -- ms

local motors = nil -- outputs: number from zero, neutral, full ahead, full astern
local trial = nil -- the one that runs: id, name, steps, start (ms), place, step
local ended = nil -- id of the mission item that was ended last

local function output(func)
  local channel = SRV_Channels:find_channel(func)
  if not channel then
    return nil
  end
  local value = function(name)
    return param:get("SERVO" .. (channel + 1) .. "_" .. name)
  end
  local neutral, ahead, astern = value("TRIM"), value("MAX"), value("MIN")
  if not (neutral and ahead and astern) then
    return nil
  end
  if value("REVERSED") == 1 then
    ahead, astern = astern, ahead
  end
  return {channel = channel, neutral = neutral, ahead = ahead, astern = astern}
end

local function order(motor, share)
  local towards = share < 0 and motor.astern or motor.ahead
  local pulse = motor.neutral + math.abs(share) * (towards - motor.neutral)
  SRV_Channels:set_output_pwm_chan_timeout(motor.channel, math.floor(pulse + 0.5), EXPIRES)
end

local function finish(message, severity, mode)
  for _, motor in ipairs(motors or {}) do -- a timeout of zero ends the override
    SRV_Channels:set_output_pwm_chan_timeout(motor.channel, math.floor(motor.neutral), 0)
  end
  gcs:send_text(severity, message)
  if trial then
    ended = trial.id
  end
  trial = nil
  if mode then
    vehicle:set_mode(mode)
  end
end

local function begin(id, number)
  ended = id -- whatever comes: no item is tried twice
  local wanted, place = TRIALS[number], ahrs:get_location()
  local left, right = output(LEFT), output(RIGHT)
  if not (wanted and place and left and right) then
    finish("trials: no such trial, position or output", WARNING, HOLD)
    return
  end
  motors = {left, right}
  trial = {id = id, name = wanted[1], steps = wanted[2], start = millis(), place = place, step = 0}
  gcs:send_text(INFO, "trial " .. trial.name .. " begins")
end

local function step_at(seconds)
  local until_now = 0
  for number, step in ipairs(trial.steps) do
    until_now = until_now + step[1]
    if seconds < until_now then
      return number, step
    end
  end
  return nil
end

local function update()
  local id, number = nil, nil
  if vehicle:get_mode() == AUTO and arming:is_armed() then
    id, number = vehicle:nav_script_time()
  end
  if trial and id ~= trial.id then
    finish("trial " .. trial.name .. " aborted", WARNING, nil)
  end
  if id and not trial and id ~= ended then
    begin(id, number)
  end
  if not trial then
    return update, EVERY
  end
  local place = ahrs:get_location()
  if not place or place:get_distance(trial.place) > FARTHEST then
    finish("trial " .. trial.name .. " ended: too far or lost", WARNING, HOLD)
    return update, EVERY
  end
  local now, step = step_at((millis() - trial.start):tofloat() / 1000)
  if not step then
    local done = trial.id
    finish("trial " .. trial.name .. " ends", INFO, nil)
    vehicle:nav_script_time_done(done)
    return update, EVERY
  end
  if now ~= trial.step then
    trial.step = now
    gcs:send_text(INFO, string.format("%s %d: %.2f %.2f", trial.name, now, step[2], step[3]))
  end
  order(motors[1], step[2])
  order(motors[2], step[3])
  return update, EVERY
end

return update, 1000
