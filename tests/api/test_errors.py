"""What can fail has one exit code each."""

import lightstage
from lightstage.api import errors


def test_errors_are_those_of_the_package_and_have_their_exit_codes() -> None:
    assert errors.RequestError is lightstage.RequestError
    assert errors.WorkError is lightstage.WorkError
    codes = {
        kind.__name__: kind.exit_code
        for kind in (errors.RequestError, errors.WorkError, errors.DamagedChunkError, errors.DamagedGroupError)
    }
    assert codes == {"RequestError": 2, "WorkError": 1, "DamagedChunkError": 1, "DamagedGroupError": 1}
    assert all(issubclass(getattr(errors, name), errors.LightstageError) for name in codes)
