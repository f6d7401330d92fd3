"""A kernel's refusal is a sentence, also when it comes from another process."""

import pickle

from lightstage.kernels.errors import KernelError


def test_its_sentence() -> None:
    error = KernelError("the ball is cut by the frame; the whole ball must be in the picture")
    assert error.sentence == str(error) == "the ball is cut by the frame; the whole ball must be in the picture"
    assert isinstance(error, ValueError)
    assert pickle.loads(pickle.dumps(error)).sentence == error.sentence
