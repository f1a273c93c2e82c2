"""MAVLink microservices, each once, client and server: messages in and out, time as an argument, no sockets.

exchange.py    Exchange, what every client is: `poll(now_ns)`, `handle(message, now_ns)`, `done`; Timer, repetition
parameters.py  ParameterClient, ParameterServer; whole numbers as PX4 writes them
missions.py    MissionUpload, MissionDownload, MissionServer for missions, fences and whatever else is a plan
commands.py    CommandClient, CommandServer; STATUSTEXT cut and joined
ftp.py         FtpClient; the packet that a server would share
modes.py       the modes of ArduRover and PX4: numbers, names, parameters of MAV_CMD_DO_SET_MODE

A server's handlers are keyed by message id in `handlers`. Another plan type is a row of MissionServer's table, another
command a row of CommandServer's. The protocols are those of mavlink.io/en/services.
"""
