"""First program on a board without xitl: read the archive from standard input, check it and run it.

`xitl_cli.deploy.ssh` sends the text of this file to `python3 -c`. The Python version of the board is unknown, so this
file must run on Python 3.6. Standard input then carries one line of JSON (`bytes`, `sha256`, `arguments`), the archive,
and the standard input of the archive.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

MARK = "xitl-result: "
OLDEST = (3, 9)


def receive(source: BinaryIO) -> int:
    """Run the archive that arrives. Return its exit code.

    Raises OSError when the archive cannot be stored, and ValueError for every other failure.
    """
    header = json.loads(source.readline().decode())
    if sys.version_info < OLDEST:
        raise ValueError(
            f"python3 on the board is {sys.version.split()[0]} and the agent needs 3.9 or newer; "
            "install a newer one (Debian 11 and later have it)"
        )
    data = source.read(header["bytes"])
    if len(data) != header["bytes"]:
        raise ValueError(f"only {len(data)} of {header['bytes']} bytes arrived; try again")
    digest = hashlib.sha256(data).hexdigest()
    if digest != header["sha256"]:
        raise ValueError(f"the received archive has the SHA-256 {digest} instead of {header['sha256']}; try again")
    handle, path = tempfile.mkstemp(prefix="xitl-agent-", suffix=".pyz")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        run = subprocess.Popen([sys.executable, path] + header["arguments"], stdin=subprocess.PIPE)
        run.communicate(source.read())
        return run.returncode
    finally:
        Path(path).unlink()


def main() -> int:
    """Receive from standard input. Print a failure as one line of JSON after `MARK`."""
    try:
        return receive(sys.stdin.buffer)
    except OSError as error:
        sentence = (
            f"the board cannot store the archive ({error.strerror}: {tempfile.gettempdir()}); free some space there"
        )
    except ValueError as error:
        sentence = str(error)
    sys.stdout.write(MARK + json.dumps({"error": sentence}) + "\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
