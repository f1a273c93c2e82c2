-- Sensors of a simulation for an unmodified ArduPilot, over its ordinary MAVLink link.
--
-- HIL_SENSOR, HIL_GPS and HIL_STATE_QUATERNION come in, VectorNav frames go to the external AHRS driver, through a
-- serial port that exists in the autopilot's memory only. The handshake of that driver is answered here.
--
-- It needs SCR_ENABLE 1, SCR_SDEV_EN 1, SCR_SDEV1_PROTO 36, EAHRS_TYPE 1 and no other port with protocol 36; all of it
-- is in rover-hil.parm. SCR_USER1 is the period in ms, 2 where it is 0. Integers and floats have 32 bits here.
--
-- Once a second NAMED_VALUE_FLOAT tells xitl_in (messages taken), xitl_out (frames handed on), xitl_drop (messages
-- that became no frame), xitl_hs (the driver has asked for frames) and xitl_gap (longest time between two IMU frames
-- handed on, in ms, since the last report).

local VERSION = 1
local HIL_SENSOR, HIL_GPS, HIL_STATE_QUATERNION = 107, 113, 115
local AHRS_PROTOCOL = 36
local MODEL = "VN-200" -- one antenna
local QUEUE, MOST_A_RUN = 25, 10
local REPORT_MS, SILENT_MS, COMPLAIN_MS = 1000, 5000, 10000
local SPEED_ACCURACY_MPS = 0.2 -- no field of HIL_GPS tells it

local pack, unpack, sub = string.pack, string.unpack, string.sub

-- CRC-16 of CCITT, start 0, two bytes a step: of a byte, and of a byte with a zero byte behind it.
local of_byte, of_word = { [0] = 0 }, { [0] = 0 }
for i = 0, 127 do
  local twice = of_byte[i] << 1
  if twice > 0xFFFF then
    twice = (twice & 0xFFFF) ~ 0x1021
  end
  of_byte[2 * i] = twice
  of_byte[2 * i + 1] = twice ~ 0x1021
end
for i = 0, 255 do
  of_word[i] = of_byte[of_byte[i] >> 8] ~ ((of_byte[i] & 0xFF) << 8)
end

local function crc_of(text, crc)
  local last = #text
  for i = 1, last - 3, 4 do
    local one, two = unpack(">I2I2", text, i)
    one = one ~ crc
    two = two ~ of_word[one >> 8] ~ of_byte[one & 0xFF]
    crc = of_word[two >> 8] ~ of_byte[two & 0xFF]
  end
  for i = last - last % 4 + 1, last do
    crc = ((crc << 8) & 0xFFFF) ~ of_byte[(crc >> 8) ~ string.byte(text, i)]
  end
  return crc
end

local NO_TIME = string.rep("\0", 8) -- the driver does not read it
local IMU_HEAD = "\x01\x21\x07" .. NO_TIME
local INS_HEAD = "\x31\x01\x00\x06\x01\x13\x06" .. NO_TIME
local GNSS_HEAD = "\x49\x03\x00\xB8\x26\x18\x00" .. NO_TIME
local IMU_CRC, INS_CRC, GNSS_CRC = crc_of(IMU_HEAD, 0), crc_of(INS_HEAD, 0), crc_of(GNSS_HEAD, 0)

local function framed(head, head_crc, body)
  return "\xFA" .. head .. body .. pack(">I2", crc_of(body, head_crc))
end

-- The double of n / 10^7 with 36 binary places, away from zero, so that the driver gets n back when it cuts.
local function degrees(n)
  if n == 0 then
    return NO_TIME
  end
  local sign = 0
  if n < 0 then
    sign, n = 1 << 31, -n
  end
  local high, rest, low = n // 10000000, n % 10000000, 0
  for _ = 1, 2 do
    rest = rest * 64
    high, rest = high << 6 | rest // 10000000, rest % 10000000
  end
  for _ = 1, 4 do
    rest = rest * 64
    low, rest = low << 6 | rest // 10000000, rest % 10000000
  end
  low = low + 1
  if low >> 24 ~= 0 then
    high, low = high + 1, 0
  end
  local exponent = 8
  while high < 0x100000 do
    high, low = high << 1 | low >> 23, low << 1 & 0xFFFFFF
    exponent = exponent - 1
  end
  return pack("<I4I4", low << 8, sign | (exponent + 1023) << 20 | high & 0xFFFFF)
end

-- GPS time in ns of a UNIX time in us, in 16-bit digits; what lies before GPS time is only brought to ns.
local EPOCH = { 0xB780, 0x4897, 0x1F5E, 0x0001 } -- 315964782 s: 1980-01-06, less the 18 leap seconds since
local function gps_time(text, at)
  local a, b, c, d = unpack("<I2I2I2I2", text, at)
  local digits = { a, b, c, d }
  local less, borrow = {}, 0
  for i = 1, 4 do
    local digit = digits[i] - EPOCH[i] - borrow
    borrow = digit < 0 and 1 or 0
    less[i] = digit & 0xFFFF
  end
  if borrow == 0 then
    digits = less
  end
  local carry = 0
  for i = 1, 4 do
    local digit = digits[i] * 1000 + carry
    digits[i], carry = digit & 0xFFFF, digit >> 16
  end
  return pack("<I2I2I2I2", digits[1], digits[2], digits[3], digits[4])
end

-- Frames, from raw messages: the payload starts at byte 13, zeros behind it.

local function imu_frame(message)
  local hpa = unpack("<f", message, 57)
  if hpa <= 0 then
    hpa = 1013.25
  end
  local accel = sub(message, 21, 32)
  local gyro = sub(message, 33, 44)
  local body = gyro .. accel .. accel .. gyro .. sub(message, 45, 56) .. sub(message, 69, 72) .. pack("<f", hpa * 0.1)
  return framed(IMU_HEAD, IMU_CRC, body)
end

local function ins_frame(message)
  local w, x, y, z = unpack("<ffff", message, 21)
  local lat, lon, alt, north, east, down = unpack("<i4i4i4i2i2i2", message, 49)
  local yaw = math.deg(math.atan(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
  local pitch = math.deg(math.asin(math.max(-1, math.min(1, 2 * (w * y - z * x)))))
  local roll = math.deg(math.atan(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
  return framed(INS_HEAD, INS_CRC, pack("<fffffff", yaw, pitch, roll, x, y, z, w)
    .. pack("<fffI2", 1, 1, 1, 6) -- tracking, with a fix
    .. degrees(lat) .. degrees(lon) .. pack("<d", alt * 0.001)
    .. pack("<fffff", north * 0.01, east * 0.01, down * 0.01, 1, SPEED_ACCURACY_MPS))
end

local function gnss_frame(message)
  local lat, lon, alt, eph, epv, _, north, east, down, _, fix, satellites = unpack("<i4i4i4I2I2I2i2i2i2I2BB", message, 21)
  if eph == 0xFFFF then
    eph = 100
  end
  if epv == 0xFFFF then
    epv = 200
  end
  if fix < 2 then
    fix = 0
  end
  return framed(GNSS_HEAD, GNSS_CRC, gps_time(message, 13) .. pack("<BB", satellites, fix)
    .. degrees(lat) .. degrees(lon) .. pack("<d", alt * 0.001)
    .. pack("<fff", north * 0.01, east * 0.01, down * 0.01)
    .. pack("<ffff", eph * 0.01, eph * 0.01, epv * 0.01, SPEED_ACCURACY_MPS)
    .. pack("<fffffff", 1.2, 1.2, 1, 1, 0.8, 0.8, 0.8)
    .. "\0\0")
end

local FRAMES = { [HIL_SENSOR] = imu_frame, [HIL_GPS] = gnss_frame, [HIL_STATE_QUATERNION] = ins_frame }

local port
local period_ms = math.floor(param:get("SCR_USER1") or 0)
if period_ms < 1 or period_ms > 50 then
  period_ms = 2
end
local sentence = ""
local streaming = false
local taken, out, dropped, gap_ms = 0, 0, 0, 0
local start_ms = millis()
local report_ms, complaint_ms, imu_ms = start_ms, start_ms, nil

local function say(severity, text)
  gcs:send_text(severity, "xitl: " .. text)
end

-- The driver's commands are answered with themselves, which is what it waits for; the model is what it wants to know.
local function answer(command)
  if sub(command, 1, 6) == "$VNRRG" then
    local text = "VNRRG,01," .. MODEL
    local sum = 0
    for i = 1, #text do
      sum = sum ~ string.byte(text, i)
    end
    command = string.format("$%s*%02X", text, sum)
  end
  port:writestring(command .. "\r\n")
  if sub(command, 1, 8) == "$VNASY,1" then
    if not streaming then
      say(6, "the VectorNav driver is connected")
    end
    streaming = true
  elseif sub(command, 1, 8) == "$VNASY,0" then
    streaming = false
  end
end

local function hear_driver()
  local text = port:readstring(128)
  if not text or #text == 0 then
    return
  end
  sentence = sub(sentence .. text, -256)
  while true do
    local ends = string.find(sentence, "\n", 1, true)
    if not ends then
      return
    end
    local command = string.match(sub(sentence, 1, ends), "%$VN[^\r\n]+")
    sentence = sub(sentence, ends + 1)
    if command then
      answer(command)
    end
  end
end

local function take_messages(now_ms)
  for _ = 1, MOST_A_RUN do
    local message = mavlink:receive_chan()
    if not message then
      return
    end
    taken = taken + 1
    local id = unpack("<I3", message, 10)
    if streaming and FRAMES[id] then
      local frame = FRAMES[id](message)
      if port:writestring(frame) == #frame then
        out = out + 1
      else
        dropped = dropped + 1
      end
      if id == HIL_SENSOR then
        if imu_ms then
          gap_ms = math.max(gap_ms, (now_ms - imu_ms):toint())
        end
        imu_ms = now_ms
      end
    else
      dropped = dropped + 1
    end
  end
end

local function report(now_ms)
  report_ms = now_ms
  gcs:send_named_float("xitl_in", taken)
  gcs:send_named_float("xitl_out", out)
  gcs:send_named_float("xitl_drop", dropped)
  gcs:send_named_float("xitl_hs", streaming and 1 or 0)
  gcs:send_named_float("xitl_gap", gap_ms)
  gap_ms = 0
  if not streaming and (now_ms - start_ms):toint() > SILENT_MS and (now_ms - complaint_ms):toint() > COMPLAIN_MS then
    complaint_ms = now_ms
    say(4, "no driver asks: EAHRS_TYPE, or a port on 36?")
  end
end

local function update()
  local now_ms = millis()
  hear_driver()
  take_messages(now_ms)
  if (now_ms - report_ms):toint() >= REPORT_MS then
    report(now_ms)
  end
  return update, period_ms
end

local function start()
  local found, device = pcall(function()
    return serial:find_simulated_device(AHRS_PROTOCOL, 0)
  end)
  port = found and device or nil
  if not port then
    say(3, found and "set SCR_SDEV_EN 1, SCR_SDEV1_PROTO 36" or "this firmware has no SCR_SDEV ports")
    return start, COMPLAIN_MS
  end
  mavlink:init(QUEUE, 3)
  mavlink:register_rx_msgid(HIL_SENSOR)
  mavlink:register_rx_msgid(HIL_GPS)
  mavlink:register_rx_msgid(HIL_STATE_QUATERNION)
  start_ms = millis()
  say(6, string.format("HIL script %d, every %d ms", VERSION, period_ms))
  return update()
end

return start()
