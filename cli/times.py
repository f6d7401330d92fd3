"""The times of a rig as options: what one picture takes, and what comes between two."""

import argparse
from typing import TYPE_CHECKING

from lightstage.api.errors import RequestError
from lightstage.cli.values import number

if TYPE_CHECKING:
    from lightstage.api.sequences import Timing


def add_timing(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--exposure-ms", type=number, metavar="MS", help="of one picture")
    parser.add_argument("--setup-ms", type=number, metavar="MS", help="to set up the lights (default: 0)")
    parser.add_argument("--readout-ms", type=number, metavar="MS", help="to read out the camera (default: 0)")
    parser.add_argument(
        "--overlap", action="store_true", help="the camera reads out while the next lights are set up"
    )
    parser.add_argument("--dark-pauses", action="store_true", help="the lights go off between exposures")


def timing_of(options: argparse.Namespace, rate_hz: float | None = None) -> "Timing | None":
    """From the options; else, when a capture says its frame rate, from that; else none."""
    from lightstage.api.sequences import timing

    wheel = getattr(options, "wheel_ms", None)
    if options.exposure_ms is None:
        given = {"--setup-ms": options.setup_ms, "--readout-ms": options.readout_ms, "--wheel-ms": wheel}
        stray = [name for name, value in given.items() if value is not None]
        switches = {"--overlap": options.overlap, "--dark-pauses": options.dark_pauses}
        stray += [name for name, value in switches.items() if value]
        if stray:
            raise RequestError(f"{stray[0]} stands alone; --exposure-ms is needed for times")
        return None if rate_hz is None else timing(exposure_ms=1000 / rate_hz)
    return timing(
        exposure_ms=options.exposure_ms,
        setup_ms=options.setup_ms or 0.0,
        readout_ms=options.readout_ms or 0.0,
        wheel_ms=wheel or 0.0,
        overlap=options.overlap,
        dark_pauses=options.dark_pauses,
    )
