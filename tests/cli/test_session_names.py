"""What sessions are called where several stand side by side."""

from pathlib import Path

import pytest

from smoother.cli.session_names import session_names


@pytest.mark.parametrize(
    ("places", "names"),
    [
        (["saturday", "sunday"], ["saturday", "sunday"]),
        (["day/kart1/run1", "day/kart2/run2", "day/kart3/run1"], ["kart1/run1", "kart2/run2", "kart3/run1"]),
        (["a/card", "b/card"], ["a/card", "b/card"]),
        (["a/LOG00002.KLG", "b/LOG00002.KLG"], ["a/LOG00002", "b/LOG00002"]),
        (["may/7/run1", "june/7/run1"], ["may/7/run1", "june/7/run1"]),
        (["a/run1", "a/run1", "a/run2"], ["run1 (1)", "run1 (2)", "run2"]),
    ],
)
def test_a_name_has_as_many_folders_as_make_it_differ(tmp_path: Path, places: list[str], names: list[str]) -> None:
    for place in places:
        path = tmp_path / place
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix:
            path.touch()
        else:
            path.mkdir(exist_ok=True)
    assert session_names([tmp_path / place for place in places], [{}] * len(places)) == names


@pytest.mark.parametrize(
    ("stated", "names"),
    [
        ([{"kart": "7"}, {"kart": "12"}], ["kart 7", "kart 12"]),
        ([{"kart": "Tony 401"}, {"kart": "Birel"}], ["Tony 401", "Birel"]),
        ([{"kart": "7", "driver": "Ann"}, {"kart": "7", "driver": "Ben"}], ["Ann", "Ben"]),
        ([{"title": "heat"}, {"title": "final"}], ["heat", "final"]),
        ([{"driver": "Ann"}, {}], ["x/run1", "y/run1"]),
    ],
)
def test_folders_of_one_name_are_called_by_what_was_stated(
    tmp_path: Path, stated: list[dict[str, str]], names: list[str]
) -> None:
    places = [tmp_path / "x" / "run1", tmp_path / "y" / "run1"]
    assert session_names(places, stated) == names
    folders = [tmp_path / "saturday", tmp_path / "sunday"]
    assert session_names(folders, stated) == ["saturday", "sunday"]


def test_drivers_who_share_karts_are_called_by_both() -> None:
    stated = [{"kart": kart, "driver": driver} for kart, driver in (("7", "Ann"), ("7", "Ben"), ("8", "Ann"))]
    places = [Path(f"/{place}/run1") for place in "xyz"]
    assert session_names(places, stated) == ["kart 7, Ann", "kart 7, Ben", "kart 8, Ann"]
