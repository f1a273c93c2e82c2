"""A process that draws images of a run's cameras.

`python -m xitl_cli.plugins.cameras.process PIPE`: number of an inherited socket. Messages to it are pickled:
StudioStart, (name, TriangleModel), Commission. Its messages are JSON: {"device": …} or {"problem": …}, then one for
each image.
"""

from __future__ import annotations

import socket
import sys
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe, until_closed
from xitl_cli.plugins.cameras.remote_studio import StudioStart, message_of
from xitl_cli.plugins.cameras.studio import Commission, Drawing, Studio


def main(pipe: Pipe) -> None:
    """Draw until the pipe is closed."""
    start, *messages = pipe.receive_first()
    assert isinstance(start, StudioStart)
    try:
        studio = Studio(start.cameras, start.models, start.still)
    except UserError as error:
        pipe.send({"problem": str(error)})
        return
    pipe.send({"device": studio.device})
    images, first_s = 0, 0.0

    def develop(commission: Commission, drawing: Drawing) -> None:
        nonlocal images, first_s
        image = studio.develop(commission, drawing)
        images += 1
        if images == 1:  # with the compilation of the programs
            first_s = time.process_time()
        pipe.send(message_of(image, 1e3 * (time.process_time() - first_s) / max(images - 1, 1)))

    with ThreadPoolExecutor(1) as darkroom:  # develops an image while the next one is drawn
        under_way: deque[Future[None]] = deque()
        while True:
            for message in messages:
                if isinstance(message, Commission):
                    under_way.append(darkroom.submit(develop, message, studio.draw(message)))
                else:
                    studio.add(*message)
            try:
                while under_way and under_way[0].done():
                    under_way.popleft().result()
            except UserError as error:
                pipe.send({"problem": str(error)})
                return
            messages = pipe.receive(0.01 if under_way else 1.0)


if __name__ == "__main__":
    with until_closed():
        main(Pipe.of_process(socket.socket(fileno=int(sys.argv[1]))))
