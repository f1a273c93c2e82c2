"""Every picture of docs/img, and what makes it; those of the paper's page, paper-…, are made by `make paper`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tools.pictures import boundary, cameras, drawings, pages, plots, scenes, terminal
from tools.pictures.drawing import Drawing
from tools.pictures.workplace import Workplace

IMAGES = Path(__file__).parents[2] / "docs/img"
Maker = Callable[[Workplace, Path], None]


def drawn(draw: Callable[[], Drawing]) -> Maker:
    """A drawing."""
    return lambda workplace, path: draw().save(path)


def typed(*commands: str, shown: tuple[int, int] = (0, 10_000)) -> Maker:
    """What the last of some commands prints; shown: its lines, from and to."""

    def make(workplace: Workplace, path: Path) -> None:
        for command in commands:
            printed = workplace.typed(command)
        terminal.draw(commands[-1], printed, path, shown)

    return make


FIRST_RUN = "xitl sim sitl --out runs/first"
PICTURES: dict[str, Maker] = {
    "architecture.svg": drawn(drawings.architecture),
    "techniques.svg": drawn(drawings.techniques),
    "node-graph.svg": drawn(drawings.node_graph),
    "wdri.svg": drawn(drawings.wdri),
    "own-boat.svg": drawn(drawings.own_boat),
    "ardupilot.svg": drawn(drawings.ardupilot),
    "px4.svg": drawn(drawings.px4),
    "boards.svg": drawn(drawings.boards),
    "virtual-board.svg": drawn(drawings.virtual_board),
    "links.svg": drawn(drawings.links),
    "ground-stations.svg": drawn(drawings.ground_stations),
    "ros.svg": drawn(drawings.ros),
    "recording.svg": drawn(drawings.recording),
    "plugins.svg": drawn(drawings.plugins),
    "profiles.svg": drawn(drawings.profiles),
    "frames.svg": drawn(drawings.frames),
    "forces.svg": drawn(drawings.vessel_forces),
    "first-run.svg": typed(FIRST_RUN),
    "vehicle-check.svg": typed("xitl init my-boat", "xitl vehicle check my-boat"),
    "make-run.webp": scenes.first_run,
    "view.png": scenes.view,
    "report.png": pages.first_report,
    "map.png": pages.report_on_a_map,
    "findings.png": pages.cut_report,
    "validation.png": pages.validation,
    "comparison.png": pages.comparison,
    "plot-a-run.png": pages.example,
    "boundary.png": lambda workplace, path: boundary.draw(workplace.folder, path),
    "vehicles.png": plots.vehicles,
    "manoeuvres.png": plots.manoeuvres,
    "own-site.png": plots.own_site,
    "seas.png": plots.seas,
    "seakeeping.png": plots.seakeeping,
    "tide.png": plots.tide,
    "faults.png": plots.faults,
    "fleet.png": plots.fleet,
    "perception.png": plots.perception,
    "cameras.jpg": cameras.draw,
    "buoys.jpg": cameras.draw_buoys,
    "radar.png": plots.radar,
    "learning.png": plots.learning,
    "identify.png": plots.identification,
    "sim-to-real.png": plots.real_boat,
    "sim-to-real-esso-osaka.png": lambda workplace, path: plots.real_boat(workplace, path, "Esso Osaka"),
    "twin.png": plots.twin,
}
