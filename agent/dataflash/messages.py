"""The messages of our logs: name, letters, columns, units, multipliers.

What ArduRover has as well is called as there and has its letter, unit and multiplier; a column is left out when we have
nothing to put there. Ours, at the end of a row: `SampleUS`, when a sample was taken by the sensors' clock, which is not
the one TimeUS is from. Ours alone: TASK and TSKQ, how each task kept its deadlines; MISS, a deadline that was missed.

In lockstep the clock stands still while a task runs and no load is measured: PM has no such column, and ours are not
there.
"""

from __future__ import annotations

from agent.dataflash.format import formats

_SERVOS = ",".join(f"C{channel}" for channel in range(1, 15))

_ROWS = (
    ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
    ("UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--"),
    ("MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--"),
    ("PARM", "QNff", "TimeUS,Name,Value,Default", "s---", "F---"),
    ("MSG", "QZ", "TimeUS,Message", "s-", "F-"),
    ("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---"),
    ("ARM", "QBI", "TimeUS,ArmState,ArmChecks", "s--", "F--"),
    ("EV", "QB", "TimeUS,Id", "s-", "F-"),
    ("ERR", "QBB", "TimeUS,Subsys,ECode", "s--", "F--"),
    (
        "CMD",
        "QHHHffffLLfB",
        "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame",
        "s-------DUm-",
        "F-------GG0-",
    ),
    (  # the item taken up
        "MISE",
        "QHHHffffLLfB",
        "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame",
        "s-------DUm-",
        "F-------GG0-",
    ),
    (
        "IMU",
        "QBfffffffQ",
        "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T,SampleUS",
        "s#EEEoooOs",
        "F-000000-F",
    ),
    (  # GMS and GWk are 0 until GPS time is known, which here it never is
        "GPS",
        "QBBIHBLLefffBQ",
        "TimeUS,I,Status,GMS,GWk,NSats,Lat,Lng,Alt,Spd,GCrs,VZ,U,SampleUS",
        "s#-s-SDUmnhn-s",
        "F--C-0GGB000-F",
    ),
    ("GPA", "QBCCCBIH", "TimeUS,I,HAcc,VAcc,SAcc,VV,SMS,Delta", "s#mmn-ss", "F-BBB-CC"),
    ("MAG", "QBhhhhhhQ", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,SampleUS", "s#GGGGGGs", "F-CCCCCCF"),
    ("BARO", "QBfcQ", "TimeUS,I,Press,Temp,SampleUS", "s#POs", "F-0BF"),
    ("ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", "sddddhh", "F000000"),
    ("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "sDUmmm", "FGG000"),
    (
        "XKF1",
        "QBccCffffffccce",
        "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ,OH",
        "s#ddhnnnmmmkkkm",
        "F-BBB000000BBBB",
    ),
    ("XKF4", "QBccccI", "TimeUS,C,SV,SP,SH,SM,SS", "s#-----", "F------"),
    ("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", "s#????", "F-????"),
    ("ORGN", "QBLLe", "TimeUS,Type,Lat,Lng,Alt", "s#DUm", "F-GGB"),
    ("RCIN", "Q" + "H" * 14, "TimeUS," + _SERVOS, "s" + "Y" * 14, "F" + "-" * 14),
    ("RCOU", "Q" + "H" * 14, "TimeUS," + _SERVOS, "s" + "Y" * 14, "F" + "-" * 14),
    ("NTUN", "QfffHf", "TimeUS,WpDist,WpBrg,DesYaw,Yaw,XTrack", "smhhhm", "F000B0"),
    ("STER", "Qhff", "TimeUS,SteerIn,LatAcc,TurnRate", "s-ok", "F-00"),
    ("THR", "Qhff", "TimeUS,ThrIn,DesSpeed,Speed", "s-nn", "F-00"),
    ("PM", "QHHHIH", "TimeUS,LR,NLon,NL,MaxT,Load", "sz---%", "F----A"),
    ("DSF", "QII", "TimeUS,Dp,Bytes", "s-b", "F-0"),
)
_TASK = (
    "TASK",
    "QBNfIIIIfIf",
    "TimeUS,I,Name,Rate,N,Miss,Skip,JMax,JMean,RMax,RMean",
    "s#-z---YYYY",
    "F--0---0000",
)
_QUANTILES = (  # J50: half of the starts came no later, as far as the histogram tells; JAtUS: when the worst one was
    "TSKQ",
    "QBIIQIIQ",
    "TimeUS,I,J50,J99,JAtUS,R50,R99,RAtUS",
    "s#YYsYYs",
    "F-00F00F",
)
_MISS = (  # Late counts from DueUS to the start, Run from there
    "MISS",
    "QNIQIII",
    "TimeUS,Name,Cycle,DueUS,Late,Run,Skip",
    "s--sYY-",
    "F--F00-",
)
_PM_IN_LOCKSTEP = ("PM", "QHHHI", "TimeUS,LR,NLon,NL,MaxT", "sz---", "F----")

FORMATS = formats((*_ROWS, _TASK, _QUANTILES, _MISS))
FORMATS_IN_LOCKSTEP = formats(_PM_IN_LOCKSTEP if row[0] == "PM" else row for row in _ROWS)
