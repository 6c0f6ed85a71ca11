"""The seeded fuzzer, for a moment; by hand it runs a million streams a codec."""

import pytest

from drivers.fuzz import CODECS, Codec, fuzz_codec, mutated


@pytest.mark.parametrize("name", CODECS)
def test_damaged_streams_break_no_codec(name):
    assert fuzz_codec(name, 3000, seed=20)["failures"] == 0


def test_a_codec_that_breaks_is_told_with_its_stream(monkeypatch):
    def survives(damaged, last):
        raise ValueError("broken")

    monkeypatch.setitem(CODECS, "broken", (Codec(lambda rng: b"abc", survives), lambda rng: b"x", b""))
    with pytest.raises(AssertionError, match="broken, stream 0"):
        fuzz_codec("broken", 10, seed=1)


def test_the_same_seed_gives_the_same_damage():
    import random

    assert mutated(b"0123456789", random.Random(4)) == mutated(b"0123456789", random.Random(4))
