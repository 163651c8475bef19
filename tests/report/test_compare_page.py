"""comparison.html as text: laps of all sessions on one line, what is real and what is not; names are text."""

import json
import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest

from smoother.report.compare_page import MOST_LAPS, Compared, comparison, losses
from smoother.report.page_html import number
from smoother.trajectory import Trajectory


def numbers(text: str) -> dict[str, object]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    document = json.loads(found.group(1))
    assert isinstance(document, dict)
    return document


def trace(document: dict[str, object], name: str) -> np.ndarray:
    traces, laps = document["traces"], document["laps"]
    assert isinstance(traces, dict) and isinstance(laps, list)
    return np.frombuffer(b64decode(traces[name]), dtype="<f4").reshape(len(laps), -1)


def test_the_laps_of_all_sessions_are_drawn_the_best_of_each_first(compared: list[Compared]) -> None:
    document = numbers(comparison(compared))
    laps = document["laps"]
    assert isinstance(laps, list)
    counts = [min(MOST_LAPS, sum(lap.is_valid for lap in one.analysis.laps)) for one in compared]
    assert len(laps) == sum(counts)
    assert document["first"] == [0, counts[0]] or document["first"] == [counts[0], 0]
    speed = trace(document, "speed")
    assert np.isfinite(speed).mean() > 0.95
    y = trace(document, "y")
    assert np.nanmean(y[counts[0] :]) - np.nanmean(y[: counts[0]]) == pytest.approx(2.0, abs=1.2)  # drives of their own


def test_the_lap_that_all_are_compared_with_loses_nothing_and_is_sure_of_it(compared: list[Compared]) -> None:
    document = numbers(comparison(compared))
    laps = document["laps"]
    assert isinstance(laps, list)
    reference = [lap["name"] for lap in laps].index(document["against_name"])
    assert np.nanmax(np.abs(trace(document, "delta")[reference])) < 2e-3
    assert np.nanmax(trace(document, "delta_sigma")[reference]) == 0.0
    others = np.delete(trace(document, "delta_sigma"), reference, axis=0)
    assert np.nanmin(np.nanmax(others, axis=1)) > 0.0


def test_a_lap_of_equal_name_and_number_is_not_taken_for_the_one_that_all_are_compared_with(
    compared: list[Compared],
) -> None:
    first, other = compared
    assert first.reference is not None and other.analysis.traces is not None and other.statistics is not None
    best, called = other.statistics.best_lap, first.analysis.laps[first.reference].number
    assert best is not None
    laps = tuple(replace(lap, number=called if i == best else 90 + i) for i, lap in enumerate(other.analysis.laps))
    twins = [
        replace(one, name="run1", analysis=replace(one.analysis, laps=its, reference_name=f"run1 lap {called}"))
        for one, its in ((first, first.analysis.laps), (other, laps))
    ]
    text = comparison(twins)
    assert np.count_nonzero(np.nanmax(trace(numbers(text), "delta_sigma"), axis=1) == 0.0) == 1
    lost = float(other.analysis.traces.delta[best, -1])
    assert f">{number(lost, 3, signed=True)}" in text and abs(lost) > 0.001
    assert text.count('"is_against":true') == 1 and "<td>+0.000</td>" not in text
    sure = [corner for corner in other.analysis.corners if np.isfinite(corner.time_lost_sigma[best])]
    assert sure and all(f"± {number(float(corner.time_lost_sigma[best]), 2)}" in text for corner in sure)


def test_a_name_is_text_wherever_it_stands(compared: list[Compared]) -> None:
    text = comparison(compared)
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert not re.findall(r"(?:href|src)=[\"'](?!#)", text)


def test_names_in_narrow_columns_may_be_parted_at_their_signs(compared: list[Compared]) -> None:
    text = comparison([replace(one, name=f"kart{k}/run1") for k, one in enumerate(compared)])
    assert len(re.findall(r"<td><span>kart\d<wbr>/run1 lap \d+</span>", text)) == 4  # time lost, and slowest speed
    assert len(re.findall(r"<td><span>kart\d<wbr>/run1, \d+ laps?</span>", text)) == 2


def test_a_loss_is_called_real_only_where_it_is(compared: list[Compared]) -> None:
    text = comparison(compared)
    starred = len(re.findall(r"<td class=\"(?:slower|faster)\">[+-][0-9.]+\*", text))
    real = 0
    for one in compared:
        said = one.statistics
        assert said is not None and said.best_lap is not None
        real += sum(bool(corner.is_real[said.best_lap]) for corner in one.analysis.corners)
        real += sum(corner.usual_is_real for corner in one.analysis.corners)
    whole = losses(compared)
    assert all(loss.is_real == (abs(loss.lost) >= loss.threshold * loss.sigma) for loss in whole)
    assert [np.isfinite(loss.lost) for loss in whole] == [one.reference is None for one in compared]
    assert starred == real + sum(loss.is_real for loss in whole)


def test_a_session_without_a_whole_lap_stands_in_the_table_and_is_not_drawn(compared: list[Compared]) -> None:
    first, other = compared
    assert other.analysis.traces is not None
    nothing = replace(other, analysis=replace(other.analysis, traces=None, statistics=None, laps=(), corners=()))
    text = comparison([first, nothing])
    laps = numbers(text)["laps"]
    assert isinstance(laps, list)
    assert all(lap["name"].startswith("first") for lap in laps)
    assert "alert(1)" in text
    assert "no whole lap on the reference line" in text and text.count("no whole lap") == 1
    lame = replace(
        other.analysis, statistics=None, laps=tuple(replace(x, reasons=("pit",)) for x in other.analysis.laps)
    )
    assert "none of its laps counts" in comparison([first, replace(other, analysis=lame)])


def test_without_attitude_there_is_no_sideslip_to_draw(compared: list[Compared]) -> None:
    def blind(one: Compared) -> Compared:
        traces = one.analysis.traces
        assert traces is not None and isinstance(one.stored.trajectory, Trajectory)
        unknown = np.full(traces.sideslip.shape, np.nan)
        return replace(one, analysis=replace(one.analysis, traces=replace(traces, sideslip=unknown)))

    traces = numbers(comparison([blind(one) for one in compared]))["traces"]
    assert isinstance(traces, dict) and "sideslip" not in traces
    half = numbers(comparison([compared[0], blind(compared[1])]))
    assert np.isfinite(trace(half, "sideslip")).any() and np.isnan(trace(half, "sideslip")).any()


def test_the_name_of_a_session_is_not_cut_within_a_word(compared: list[Compared]) -> None:
    named = replace(compared[0], name="kart_okc_doves")
    assert "<td><span>kart_<wbr>okc_<wbr>doves</span></td>" in comparison([named, compared[1]])
