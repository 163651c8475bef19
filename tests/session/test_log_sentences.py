"""The sentences of a recording: held as columns, they behave as a tuple of pairs."""

import numpy as np
import pytest

from smoother.session import log_decode
from smoother.session.log_decode import Sentences

PAIRS = tuple((1000 * i, b"$" * (i % 7)) for i in range(50))


@pytest.fixture
def sentences(monkeypatch: pytest.MonkeyPatch) -> Sentences:
    """PAIRS, which came in three parts and are taken out eight at once."""
    monkeypatch.setattr(log_decode, "SENTENCES_TOGETHER", 8)
    made = Sentences()
    for part in (PAIRS[:20], (), PAIRS[20:]):
        made.extend(part)
    return made


def test_they_are_the_pairs_that_were_put_in(sentences: Sentences) -> None:
    assert tuple(sentences) == PAIRS
    assert sentences == PAIRS and sentences == PAIRS
    assert len(sentences) == len(PAIRS)
    assert repr(sentences) == repr(PAIRS)


@pytest.mark.parametrize("at", [0, 17, -1, slice(-1, None), slice(None, 9), slice(40, 3, -5), slice(60, 70)])
def test_they_are_indexed_as_a_tuple_is(sentences: Sentences, at: int | slice) -> None:
    assert sentences[at] == PAIRS[at]


def test_other_pairs_are_not_equal(sentences: Sentences) -> None:
    assert sentences != PAIRS[:-1]
    assert sentences != (*PAIRS[:-1], (0, b"$GPRMC"))
    assert sentences != 5


def test_there_may_be_none() -> None:
    assert tuple(Sentences()) == ()
    assert not Sentences()
    with pytest.raises(IndexError):
        Sentences()[0]


def test_times_are_plain_integers(sentences: Sentences) -> None:
    assert not any(isinstance(t, np.integer) for t, _ in sentences)
