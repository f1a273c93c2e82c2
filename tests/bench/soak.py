"""`make soak`: ten minutes at 2000 messages a second, and what was lost. Takes SECONDS as its argument."""

from __future__ import annotations

import sys

from tests.bench.bench_link import lost_messages

if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    for name, count in lost_messages(seconds).items():
        print(f"{name:18} {count}")
