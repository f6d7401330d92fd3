"""Which camera is the reference: the cross camera, or the only one. Facts: pure Python, for whoever reads names."""

from collections.abc import Mapping, Sequence


def reference_camera(cameras: Mapping[str, str]) -> str:
    """The camera whose grid everything is brought to, of camera names by polarisation."""
    return cameras.get("cross") or next(iter(cameras.values()))


def reference_index(polarisations: Sequence[str]) -> int:
    """Where along the axis `polarisation` its pictures lie."""
    return polarisations.index("cross") if "cross" in polarisations else 0
