"""A companion as a node: it is there, beats, keeps time, and claims no more."""

from __future__ import annotations

from node_host import HELLO, MS, START, STOP, Host, of, texts

from agent.companion.role import CompanionRole
from agent.wire import dialect as mav


def test_it_announces_its_nodes_and_answers() -> None:
    host = Host(CompanionRole())
    info, status = host.run(HELLO)
    assert info.nodes == "HS,HC,HA"
    assert status.running == 0
    assert host.run(START)[1].running == 1
    (answer,) = of("XITL_TIMESYNC", host.send(mav.MAVLink_xitl_timesync_message(5, 0, 0, 9)))
    assert answer.t1_ns == 5


def test_its_heart_beats_once_a_second_and_its_task_is_measured() -> None:
    host = Host(CompanionRole())
    host.run(START)
    said = [message for _ in range(100) for message in host.live(0.1)]
    beats = of("HEARTBEAT", said)
    assert len(beats) == 10
    assert beats[0].type == mav.MAV_TYPE_ONBOARD_CONTROLLER
    assert beats[0].autopilot == mav.MAV_AUTOPILOT_INVALID
    watch = [task for task in of("XITL_TASK_STATS", said) if task.task == "watch"][-1]
    assert watch.rate_hz == 10.0
    assert sum(watch.run_histogram) == watch.cycles == 101
    assert (watch.missed, watch.start_jitter_max_usec) == (0, 0)
    assert not of("XITL_ACTUATORS", said)
    tasks = of("XITL_TASK_STATS", host.run(STOP))
    assert {task.task for task in tasks} == {"watch", "perceive", "plan", "tell", "telemetry", "status"}


def test_a_silent_host_is_said_once_and_when_it_is_back() -> None:
    host = Host(CompanionRole())
    host.run(START)
    said = [*host.live(3.0, imu=False), *host.send(host.imu(1)), *host.live(0.5)]
    assert texts(said) == ["Host is silent", "Host is back"]


def test_deadlines_it_misses_are_told() -> None:
    host = Host(CompanionRole())
    host.run(START)
    host.clock.time_ns += 1000 * MS
    told = of("XITL_TASK_MISS", host.send() + host.live(0.2))
    assert ("watch", 9) in {(miss.task, miss.skipped) for miss in told}


def test_its_tasks_have_their_rates() -> None:
    host = Host(CompanionRole())
    host.run(START)
    tasks = of("XITL_TASK_STATS", host.live(2.0))
    rates = {task.task: task.rate_hz for task in tasks}
    assert rates == {"watch": 10.0, "perceive": 25.0, "plan": 5.0, "tell": 2.0, "telemetry": 10.0, "status": 1.0}


def test_a_host_is_silent_after_more_than_a_second() -> None:
    host = Host(CompanionRole())
    host.run(START)
    assert texts(host.live(1.0, imu=False)) == []
    assert texts(host.live(0.2, imu=False)) == ["Host is silent"]
