"""The names near one that is not there."""

from __future__ import annotations

from functools import cache

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.search.near_names import NearNames, edit_distance

NAMES = (
    "/battery_state",
    "/camera/front/image_raw",
    "/camera/rear/image_raw",
    "/camera/",
    "/cmd_vel",
    "/imu",
    "/odom",
    "/robot1/odom",
)
WORDS = st.text("abc", max_size=7)
ABSOLUTE = st.lists(st.text("ab", min_size=1, max_size=6), min_size=1, max_size=3).map(lambda one: "/" + "/".join(one))


def naive_distance(one: str, other: str) -> int:
    """The optimal string alignment distance as its definition has it."""

    @cache
    def distance(i: int, j: int) -> int:
        if not i or not j:
            return i + j
        found = min(
            distance(i - 1, j) + 1, distance(i, j - 1) + 1, distance(i - 1, j - 1) + (one[i - 1] != other[j - 1])
        )
        if i > 1 and j > 1 and one[i - 1] == other[j - 2] and one[i - 2] == other[j - 1]:
            found = min(found, distance(i - 2, j - 2) + 1)
        return found

    return distance(len(one), len(other))


@given(WORDS, WORDS, st.integers(0, 3))
def test_the_bounded_distance_is_the_distance_up_to_its_bound(one: str, other: str, limit: int) -> None:
    naive = naive_distance(one, other)
    found = edit_distance(one, other, limit)
    assert found == naive if naive <= limit else found > limit


@given(st.lists(ABSOLUTE, max_size=12), st.text("ab", min_size=1, max_size=6))
def test_looking_through_masks_leaves_out_no_name_of_few_edits(names: list[str], wanted: str) -> None:
    found = NearNames(names).of(f"/{wanted}", limit=1000)
    for name in names:
        last = name.rpartition("/")[2]
        if name != f"/{wanted}" and naive_distance(last, wanted) <= min(2, len(wanted) // 3):
            assert name in found


def test_names_with_typing_errors_or_in_other_namespaces_are_near_and_at_most_five() -> None:
    expected: dict[str, list[str]] = {
        "/battery_stat": ["/battery_state"],
        "/batery_state": ["/battery_state"],
        "/battrey_state": ["/battery_state"],
        "/battery": ["/battery_state"],
        "/Odom": ["/odom", "/robot1/odom"],
        "/robot2/odom": ["/odom", "/robot1/odom"],
        "/camera/image_raw": ["/camera/rear/image_raw", "/camera/front/image_raw"],
        "/camra/": ["/camera/"],
        "/robot1/odom": ["/odom"],
        "/batery": ["/battery_state"],
        "/batterystat": ["/battery_state"],
        "/BatteryStates": ["/battery_state"],
        "/stat": ["/battery_state"],
        "/vel": ["/cmd_vel"],
        "/camra_imgae": ["/camera/rear/image_raw", "/camera/front/image_raw"],
        "/gripper": [],
        "/gripper_state": [],
        "/": [],
    }
    assert {wanted: NearNames(NAMES).of(wanted) for wanted in expected} == expected
    assert len(NearNames(f"/robot{number}/odom" for number in range(50)).of("/odom")) == 5
    assert len(NearNames(f"/robot{number}/joint_state" for number in range(50)).of("/jont")) == 5
