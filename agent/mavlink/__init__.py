"""MAVLink microservices, each once, client and server: messages in and out, time as an argument, no sockets.

exchange.py    Exchange, what every client is: `poll(now_ns)`, `handle(message, now_ns)`, `done`; Timer, repetition
parameters.py  ParameterClient, ParameterServer; whole numbers as PX4 writes them
missions.py    MissionUpload, MissionDownload, MissionServer for missions, fences and whatever else is a plan
commands.py    CommandClient, CommandServer; STATUSTEXT cut and joined
ftp.py         FtpClient, FtpPacket
ftp_server.py  FtpServer: lists, checksums, reads and bursts of what a Files has
parameter_file.py  @PARAM/param.pck as ArduPilot packs it
logs.py        LogServer: LOG_REQUEST_LIST, LOG_REQUEST_DATA
modes.py       the modes of ArduRover and PX4: numbers, names, parameters of MAV_CMD_DO_SET_MODE

A server's handlers are keyed by message id. What is to come, and where: another command is a row of CommandServer's
table, another kind of plan one of MissionServer's, another mission item a case of the plan that keeps it
(agent/fcu/mavlink/plans.py), another file one of agent/fcu/mavlink/files.py. A station that speaks MAVLink 1
(`came_as_mavlink1`) has no mission_type, 0 is taken then, and is asked for its items by MISSION_REQUEST.

The protocols are those of mavlink.io/en/services.
"""
