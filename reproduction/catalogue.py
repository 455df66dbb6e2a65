"""The items of the source, and the function that reproduces each."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from reproduction.errors import UnknownItem
from reproduction.results import Reproduced
from reproduction.workspace import Workspace

Make = Callable[[Workspace], Reproduced]


@dataclass(frozen=True)
class Item:
    """A figure or table of the source, or a question that it leaves open.

    Attributes:
        id: the source's number; "open-…" for its open questions, "script" for its program.
        title: what it shows.
        place: "module:function" that reproduces it.
        seconds: approximate work on one core; long items are started first.
        group: items of one group are reproduced in sequence in one process, and share intermediate results in memory.
    """

    id: str
    title: str
    place: str
    seconds: float = 5.0
    group: str = ""

    def make(self) -> Make:
        """Import and return the function."""
        module, name = self.place.split(":")
        return getattr(importlib.import_module(f"reproduction.items.{module}"), name)


@dataclass(frozen=True)
class Page:
    """A page of the book in the docs: its file's name, its title, and the number of the first of its items."""

    name: str
    title: str
    first: str


ITEMS: tuple[Item, ...] = (
    Item("2.2", "Amplification and phase lag of the rotor alone", "rotor_alone:frequency_response_2_2"),
    Item("2.3", "Forces on a light pendulum below, at and above resonance", "rotor_alone:forces_2_3"),
    Item("3.2", "What a pendulum set can balance: regions of first mass moments", "balancing_regions:regions_3_2", 8.0),
    Item("3.3", "The same for a series of imbalances", "balancing_regions:series_3_3", 4.0),
    Item("3.4", "Where each pendulum set can put the centre of gravity", "gravity_circles:gravity_circles_3_4", 3.0),
    Item("3.5", "The three types of singular points", "point_poses:types_3_5", 3.0),
    Item("table-3.1", "Stability of Type I, balanced", "stability_tables:table_3_1", 4.0),
    Item("table-3.2", "Stability of Type II, pendulums opposed", "stability_tables:table_3_2", 5.0),
    Item("table-3.3", "Stability of Type III, pendulums together", "stability_tables:table_3_3", 5.0),
    Item("table-3.4", "Which type is stable in six cases", "stable_summary:table_3_4", 12.0),
    Item("3.6", "Loss of singular points, properly oversized", "lost_points:loss_3_6", 20.0),
    Item("3.7", "Loss of singular points, improperly oversized", "lost_points:loss_3_7", 20.0),
    Item(
        "3.11",
        "Amplitude over the imbalance, below resonance",
        "nonidentical_pendulums:amplitude_below_3_11",
        45.0,
        "below",
    ),
    Item("3.12", "Pendulum positions, below resonance", "nonidentical_pendulums:positions_below_3_12", 3.0, "below"),
    Item(
        "3.13",
        "Amplitude over the imbalance, above resonance",
        "nonidentical_pendulums:amplitude_above_3_13",
        45.0,
        "above",
    ),
    Item("3.14", "Pendulum positions, above resonance", "nonidentical_pendulums:positions_above_3_14", 3.0, "above"),
    Item("3.15", "Release of different pendulums", "release_transients:release_of_different_3_15", 15.0),
    Item("3.16", "Amplitude with equal pendulums", "identical_pendulums:amplitude_3_16", 110.0, "equal"),
    Item("3.17", "Positions of equal pendulums", "identical_pendulums:positions_3_17", 25.0, "equal"),
    Item("3.18", "Release of equal pendulums", "release_transients:release_of_equal_3_18", 15.0),
    Item("3.21", "Vibration over the pivot's shift, computed", "shifted_pivots:vibration_3_21", 6.0),
    Item("3.22", "Positions over the pivot's shift, computed", "shifted_pivots:positions_3_22", 4.0),
    Item("3.23", "Vibration over the pivot's shift, recorded", "recorded_shifts:vibration_3_23", 100.0, "shift"),
    Item("3.24", "Positions over the pivot's shift, recorded", "recorded_shifts:positions_3_24", 15.0, "shift"),
    Item("3.27", "Final positions of balls and vibration, start-up by start-up", "start_ups:balls_3_27", 75.0),
    Item(
        "3.28", "Contact and friction arms of ball and pendulum, scatter over friction", "friction_arms:arms_3_28", 30.0
    ),
    Item("3.29", "Final positions of pendulums and vibration, start-up by start-up", "start_ups:pendulums_3_29", 45.0),
    Item("3.30", "Final positions of pendulums, closer", "start_ups:zoomed_3_30", 45.0),
    Item("4.1", "Coarse stability map of the balanced state", "floquet_maps:coarse_map_4_1", 8.0),
    Item("4.2", "Borders of the stable areas and the points", "floquet_maps:fine_map_4_2", 5.0),
    Item("4.3", "Largest multipliers along the points' line", "multipliers_on_line:largest_multiplier_4_3", 5.0),
    Item("4.4", "Three views of the multipliers", "multipliers_on_line:three_views_4_4", 5.0),
    Item("4.5", "Borders over the suspension's damping", "damping_families:family_over_zeta_4_5", 40.0),
    Item("4.6", "Borders over the pendulums' damping", "damping_families:family_over_c34_4_6", 30.0),
    Item("4.10", "Point A, simulated and recorded", "points:point_a_4_10", 10.0, "points"),
    Item("4.11", "Point B, simulated and recorded", "points:point_b_4_11", 10.0, "points"),
    Item("4.12", "Point C, simulated and recorded", "points:point_c_4_12", 10.0, "points"),
    Item("4.13", "Point D, simulated and recorded", "points:point_d_4_13", 10.0, "points"),
    Item("4.14", "Point E, simulated and recorded", "points:point_e_4_14", 10.0, "points"),
    Item("open-lost-points", "Open question: where nothing is stable", "open_lost_points:open_lost_points", 25.0),
    Item("open-gravity", "Open question: gravity on a horizontal shaft", "open_questions:gravity", 6.0),
    Item("open-damping", "Open question: the best damping of the pendulums", "open_questions:pendulum_damping", 15.0),
    Item("open-type-iii", "Open question: Type III on anisotropic suspensions", "open_questions:type_three", 30.0),
    Item("open-step", "Open question: a sudden change of the imbalance", "open_questions:imbalance_step", 5.0),
    Item("script", "The run-up program, faulty and right", "run_up_script:run_up_script", 5.0),
)


PAGES = (
    Page("rotor_alone", "The rotor alone", "2.2"),
    Page("singular_points", "Singular points and their stability", "3.2"),
    Page("imbalance_and_pivots", "Amplitude and positions over imbalance and pivot", "3.11"),
    Page("repeated_start_ups", "Balls and pendulums, start-up by start-up", "3.27"),
    Page("stable_areas", "Stable areas and multipliers", "4.1"),
    Page("validation_points", "The points A to E", "4.10"),
    Page("open_questions", "Open questions", "open-lost-points"),
    Page("run_up_program", "The run-up program", "script"),
)


def pages(items: Iterable[Item]) -> dict[Page, list[Item]]:
    """Return the items of each page that has any, in the source's order."""
    first = {page.first: page for page in PAGES}
    wanted = set(items)
    found: dict[Page, list[Item]] = {}
    of_page: list[Item] = []
    for item in ITEMS:
        if item.id in first:
            found[first[item.id]] = of_page = []
        if item in wanted:
            of_page.append(item)
    return {page: of_page for page, of_page in found.items() if of_page}


def chosen(ids: Sequence[str]) -> list[Item]:
    """Return items by their numbers, in the source's order; all items for no numbers.

    Args:
        ids: "2.2", or "2" and "3.1" for all items whose numbers begin with these parts.
    Raises:
        UnknownItem: no item has the number.
    """
    if not ids:
        return list(ITEMS)
    found = set[str]()
    for wanted in ids:
        own = [item.id for item in ITEMS if item.id == wanted or item.id.startswith((f"{wanted}.", f"{wanted}-"))]
        if not own:
            raise UnknownItem(f"no item {wanted!r} of the source; known: {', '.join(item.id for item in ITEMS)}")
        found.update(own)
    return [item for item in ITEMS if item.id in found]
