-- The manoeuvres of the profile identify-excitation on a boat with ArduPilot Rover, for `xitl identify vessel`.
--
-- Copy it to APM/scripts and set SCR_ENABLE 1. Set RCx_OPTION 300 (Scripting1) for a free switch. In open water, arm in
-- MANUAL and raise the switch: the steps begin. Lower it, or change the mode, and the sticks are yours again.
-- Log with LOG_BITMASK bit 10 (RC output), and with IMU, GPS and EKF as usual.

local STEERING, THROTTLE = 1, 3 -- RCMAP_ROLL, RCMAP_THROTTLE
local MANUAL, SWITCH_OPTION, HIGH = 0, 300, 2
local PERIOD_MS = 50

-- Seconds, steering (positive to starboard) and throttle, as shares of full
local STEPS = {
  -- rest, until the estimate is ready
  { 5, 0, 0 },
  -- thrust steps, and a coasting stop
  { 15, 0, 0.35 },
  { 12, 0, 0.7 },
  { 10, 0, 1 },
  { 15, 0, 0 },
  -- astern, and a coasting stop
  { 10, 0, -0.5 },
  { 10, 0, 0 },
  -- spins on the spot
  { 8, 0.3, 0 },
  { 8, 0.7, 0 },
  { 5, 0, 0 },
  { 8, -0.5, 0 },
  { 6, -1, 0 },
  { 6, 0, 0 },
  -- turns while coasting, so that the boat slides sideways
  { 8, 0, 0.9 },
  { 4, 0.8, 0 },
  { 4, -0.8, 0 },
  { 8, 0, 0 },
  { 8, 0, 0.9 },
  { 4, -0.8, 0 },
  { 4, 0.8, 0 },
  { 8, 0, 0 },
  -- zig-zags
  { 3, 0.4, 0.5 },
  { 3, -0.4, 0.5 },
  { 3, 0.4, 0.5 },
  { 3, -0.4, 0.5 },
  { 3, 0.4, 0.5 },
  { 3, -0.4, 0.5 },
  { 3, 0.4, 0.5 },
  { 3, -0.4, 0.5 },
  { 5, 0.3, 0.8 },
  { 5, -0.3, 0.8 },
  { 5, 0.3, 0.8 },
  { 5, -0.3, 0.8 },
  { 5, 0.3, 0.8 },
  { 5, -0.3, 0.8 },
  -- turning circles
  { 20, 0.25, 0.5 },
  { 5, 0, 0.5 },
  { 20, -0.25, 0.5 },
  { 12, -0.5, 0.6 },
  { 10, 0, 0 },
}

local step, ends_ms = 0, 0

local function set(channel, share)
  local pulse = rc:get_channel(channel)
  if pulse then
    pulse:set_override(math.floor(1500 + 400 * share + 0.5))
  end
end

local function update()
  local switch = rc:find_channel_for_option(SWITCH_OPTION)
  local wanted = switch and switch:get_aux_switch_pos() == HIGH
  if not (wanted and arming:is_armed() and vehicle:get_mode() == MANUAL) then
    if step > 0 and step <= #STEPS then
      gcs:send_text(4, "excitation: stopped at step " .. step)
    end
    step, ends_ms = 0, 0
    return update, PERIOD_MS
  end
  if step > #STEPS then
    return update, PERIOD_MS
  end
  local now_ms = millis():toint()
  if step == 0 or now_ms >= ends_ms then
    step = step + 1
    if step > #STEPS then
      set(STEERING, 0)
      set(THROTTLE, 0)
      gcs:send_text(5, "excitation: done")
      return update, PERIOD_MS
    end
    ends_ms = now_ms + 1000 * STEPS[step][1]
    gcs:send_text(6, "excitation: step " .. step .. " of " .. #STEPS)
  end
  set(STEERING, STEPS[step][2])
  set(THROTTLE, STEPS[step][3])
  return update, PERIOD_MS
end

return update()
