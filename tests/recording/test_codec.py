"""Messages survive the way to disk exactly."""

import json

import numpy as np
import pytest
from hypothesis import given, settings

from fieldkit.messages import Pose, RssReading, SourceEstimate
from fieldkit.recording import codec
from fieldkit.recording.schema import TOPICS, json_schema

from .samples import commands, estimate, events, others, same


@settings(max_examples=150, deadline=None)
@given(events | commands | others)
def test_decoding_gives_back_exactly_what_was_encoded(message):
    assert same(codec.decode(type(message), codec.encode(message)), message)


@settings(max_examples=50, deadline=None)
@given(events | commands | others)
def test_what_is_written_is_strict_json(message):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    json.loads(codec.encode(message), parse_constant=refuse)


def test_numpy_numbers_come_back_as_equal_plain_ones():
    pose = Pose(np.int64(5), "r1", np.float64(0.1), np.float32(0.1))
    assert codec.decode(Pose, codec.encode(pose)) == pose


def test_unknown_fields_are_ignored_and_missing_ones_take_their_default():
    data = b'{"t_ns":1,"robot":"r1","rss_dbm":-50.5,"antenna":"new"}'
    assert codec.decode(RssReading, data) == RssReading(1, "r1", -50.5)


def test_a_word_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="expected a number"):
        codec.decode(RssReading, b'{"t_ns":1,"robot":"r1","rss_dbm":"loud"}')


def test_every_topic_has_a_schema_that_names_all_fields():
    for topic in TOPICS:
        schema = json_schema(topic)
        if topic.kind is None or topic.family == "sources":
            continue
        assert set(topic.kind.__dataclass_fields__) <= set(schema["properties"])


def test_a_source_estimates_covariance_keeps_its_shape():
    assert codec.decode(SourceEstimate, codec.encode(estimate())).cov_m2.shape == (2, 2)
