"""Optional packages: the extra of xitl for each, and whether it is installed."""

from __future__ import annotations

from importlib.util import find_spec

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError


@dataclass(frozen=True, slots=True)
class Extra:
    """An extra of xitl."""

    name: str
    packages: tuple[str, ...]
    """Import names."""
    what: str
    """Its purpose."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages that are not installed."""
        return tuple(package for package in self.packages if find_spec(package) is None)

    def require(self, who: str) -> None:
        """Raise UserError, with the command to type, when a package is missing. who: with its verb, `a map needs`."""
        if self.missing:
            raise UserError(f"{who} {' and '.join(self.missing)}, which is not installed; {self.pip_line}")

    @property
    def pip_line(self) -> str:
        """Command that installs the extra."""
        return f"pip install 'xitl[{self.name}]'"


PERCEPTION = Extra("perception", ("embreex", "kiss_icp", "trimesh"), "lidar, sonar, meshes and a companion")
CAMERA = Extra("camera", ("moderngl", "cv2", "PIL"), "cameras")
ONNX = Extra("onnx", ("onnxruntime",), "detectors of objects in camera images: networks in the format ONNX")
PANDAS = Extra("pandas", ("pandas",), "tables of logs as data frames")
PARQUET = Extra("parquet", ("pyarrow",), "export of logs to Parquet")
REPORT = Extra("report", ("plotly",), "pages of logs with plots and a map")
CAMPAIGN = Extra(
    "campaign",
    ("cryptography", "dask", "distributed", "optuna", "pyarrow", "SALib", "scipy"),
    "campaigns: many runs on Dask, searches",
)
VIEW = Extra("view", ("viser", "PIL"), "the 3D view of a run and of recordings")
FIGURES = Extra("figures", ("matplotlib",), "figures of the paper's experiments, and plots of logs, as images")
ROS2 = Extra("ros2", ("cyclonedds",), "topics for ROS 2 where none is sourced")
GYM = Extra("gym", ("gymnasium",), "learning environments: xitl.make_env, xitl.make_vec_env")
IDENTIFY = Extra("identify", ("scipy",), "system identification: xitl identify")
BEM = Extra("bem", ("capytaine",), "wave forces of a hull by a panel code: xitl vehicle hydrodynamics")
EXTRAS = (PERCEPTION, CAMERA, ONNX, PANDAS, PARQUET, REPORT, CAMPAIGN, VIEW, FIGURES, ROS2, GYM, IDENTIFY, BEM)
