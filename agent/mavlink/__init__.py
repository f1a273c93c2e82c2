"""MAVLink microservices, client and server: messages in and out, time as an argument, no sockets.

    exchange.py    Exchange, the interface of every client: `poll(now_ns)`, `handle(message, now_ns)`, `done`; Timer
    parameters.py  ParameterClient, ParameterServer; integers in PX4's encoding
    missions.py    MissionUpload, MissionDownload, MissionServer for missions, fences and other plans
    commands.py    CommandClient, CommandServer; STATUSTEXT split and joined
    ftp.py         FtpClient, FtpPacket
    ftp_server.py  FtpServer: lists, checksums, reads and bursts of the files of a Files
    parameter_rows.py  Parameter, a row of a table of parameters; ArduPilot's .parm files
    parameter_file.py  @PARAM/param.pck in ArduPilot's format
    logs.py        LogServer: LOG_REQUEST_LIST, LOG_REQUEST_DATA
    modes.py       modes of ArduRover and PX4: numbers, names, parameters of MAV_CMD_DO_SET_MODE

A server's handlers are keyed by message id. To extend it: another command is a row of CommandServer's table, and
another kind of plan is a row of MissionServer's. Another mission item is a case of its plan
(agent/fcu/mavlink/plans.py). Another file belongs in agent/fcu/mavlink/files.py.

Messages of a MAVLink 1 station (`came_as_mavlink1`) have no mission_type, so 0 is used. Such a station gets
MISSION_REQUEST for its items. The protocols are those of mavlink.io/en/services.
"""
