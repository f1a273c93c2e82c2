"""MAVLink microservices, each once, client and server: messages in and out, time as an argument, no sockets.

exchange.py    Exchange, what every client is: `poll(now_ns)`, `handle(message, now_ns)`, `done`; Timer, repetition
parameters.py  ParameterClient, ParameterServer; whole numbers as PX4 writes them
missions.py    MissionUpload, MissionDownload, MissionServer for missions, fences and whatever else is a plan
commands.py    CommandClient, CommandServer; STATUSTEXT cut and joined
ftp.py         FtpClient; the packet that a server would share
modes.py       the modes of ArduRover and PX4: numbers, names, parameters of MAV_CMD_DO_SET_MODE

A server's handlers are keyed by message id. What is to come, and where: another command is a row of CommandServer's
table, another kind of plan one of MissionServer's, another mission item a case of the plan that keeps it
(agent/fcu/mavlink/plans.py); an FTP server stands beside the client and answers with its FtpPacket; a station that
speaks MAVLink 1 has no mission_type (0 is taken then) and is sent MISSION_ITEM (`item_message`, `whole`).

The protocols are those of mavlink.io/en/services.
"""
