"""A load on purpose: processes that keep every processor busy for a share of the time and end with this one."""

from __future__ import annotations

import os
import subprocess
import sys

from agent.timing.realtime import ordinary

# A period of 10 ms. The end of standard input is that of whoever started it.
_BURN = """
import os, select, sys, time
share, cpu = float(sys.argv[1]), int(sys.argv[2])
if cpu >= 0:
    try:
        os.sched_setaffinity(0, (cpu,))
    except OSError:
        pass
while True:
    until = time.monotonic() + 0.01 * share
    while time.monotonic() < until:
        pass
    if select.select((0,), (), (), 0.01 * (1.0 - share))[0]:
        sys.exit()
"""


class CpuLoad:
    """`share` of every processor is kept busy, 0 to 1; 0 at first."""

    def __init__(self) -> None:
        self.share = 0.0
        self._processes: list[subprocess.Popen[bytes]] = []

    def set(self, share: float) -> str:
        """Keep so much busy from now on; the same again changes nothing. Returns why not, or nothing."""
        if share == self.share:
            return ""
        self.close()
        if share <= 0.0:
            return ""
        processors = range(os.cpu_count() or 1) if hasattr(os, "sched_setaffinity") else (-1,)
        try:
            with ordinary():
                for cpu in processors:
                    self._processes.append(
                        subprocess.Popen(
                            [sys.executable, "-S", "-E", "-c", _BURN, f"{min(share, 1.0)}", f"{cpu}"],
                            stdin=subprocess.PIPE,
                            stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL,
                        )
                    )
        except OSError as error:
            self.close()
            return f"no load: {sys.executable} cannot be started ({error.strerror})"
        self.share = share
        return ""

    @property
    def processes(self) -> list[int]:
        """Their ids."""
        return [process.pid for process in self._processes]

    def close(self) -> None:
        """No load any more."""
        processes, self._processes, self.share = self._processes, [], 0.0
        for process in processes:
            process.kill()
        for process in processes:
            if process.stdin is not None:
                process.stdin.close()
            process.wait()
