-- ArduPilot's scripting interface as far as xitl_hil.lua uses it, fed from a file:
--   lua autopilot_scripting.lua SCRIPT INPUT OUTPUT
-- INPUT: records of a kind (1 byte), a length (2 bytes, little endian) and that many bytes: M a raw message, D bytes of
-- the driver, R one run after a number of ms (4 bytes), F a limit of bytes that the port takes (4 bytes), P a
-- parameter (name=value), X without its port. OUTPUT: records of the same form: D bytes for the driver, T a text
-- (severity, then the text), N a number by name (name=value), S a period in ms (4 bytes) that the script asked for.

local script, input, output = arg[1], io.open(arg[2], "rb"):read("a"), io.open(arg[3], "wb")

local function put(kind, bytes)
  output:write(kind, string.pack("<I2", #bytes), bytes)
end

local clock = 1000
local queue, heard, room, values, has_port = {}, "", nil, {}, true

local instant = {}
instant.__index = instant
function instant:toint() return self.ms end
instant.__sub = function(one, other) return setmetatable({ ms = one.ms - other.ms }, instant) end

function millis() return setmetatable({ ms = clock }, instant) end
gcs = {}
function gcs:send_text(severity, text) put("T", string.char(severity) .. text) end
function gcs:send_named_float(name, value)
  assert(#name <= 10, name)
  put("N", name .. "=" .. string.format("%.9g", value))
end
param = {}
function param:get(name) return values[name] end
mavlink = {}
function mavlink:init(length, numbers)
  assert(length <= 25 and numbers <= 25)
end
local wanted = {}
function mavlink:register_rx_msgid(id)
  wanted[id] = true
  return true
end
function mavlink:receive_chan()
  local message = table.remove(queue, 1)
  if message then
    return message, 0, millis()
  end
end
local device = {}
function device:readstring(count)
  local text = string.sub(heard, 1, count)
  heard = string.sub(heard, count + 1)
  return text
end
function device:writestring(text)
  local taken = room and math.min(room, #text) or #text
  if room then
    room = room - taken
  end
  put("D", string.sub(text, 1, taken))
  return taken
end
serial = {}
function serial:find_simulated_device(protocol, instance)
  assert(protocol == 36 and instance == 0)
  return has_port and device or nil
end

local run, period
local at = 1
while at <= #input do
  local kind, length = string.unpack("<c1I2", input, at)
  local bytes = string.sub(input, at + 3, at + 2 + length)
  at = at + 3 + length
  if kind == "M" then
    if run and wanted[string.unpack("<I3", bytes, 10)] and #queue < 25 then
      queue[#queue + 1] = bytes
    end
  elseif kind == "D" then
    heard = heard .. bytes
  elseif kind == "F" then
    room = string.unpack("<I4", bytes)
  elseif kind == "P" then
    local name, value = string.match(bytes, "([^=]+)=(.+)")
    values[name] = tonumber(value)
  elseif kind == "X" then
    has_port = false
  elseif kind == "R" then
    clock = clock + string.unpack("<I4", bytes)
    if run then
      run, period = run()
    else
      run, period = dofile(script)
    end
    put("S", string.pack("<I4", period))
  end
end
output:close()
