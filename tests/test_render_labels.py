"""Labels of a drawing avoid each other, lines, and the edges of shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crane_exudyn import Crane
from crane_exudyn.render_frames import overview
from crane_exudyn.render_labels import Label, Shapes, leader, place

PAGE = np.array([300.0, 200.0])
NOTHING = Shapes(PAGE, [])


def boxes(labels, middles):
    return [(at - label.half, at + label.half) for label, at in zip(labels, middles, strict=True)]


def apart(a, b):
    return bool((a[1] <= b[0]).any() or (b[1] <= a[0]).any())


def test_labels_of_one_place_stand_apart_and_on_the_page():
    labels = [Label(np.array([150.0, 100.0]), np.array([30.0, 6.0])) for _ in range(6)]
    found = boxes(labels, place(labels, PAGE, np.zeros((0, 2)), NOTHING))
    assert all(apart(a, b) for i, a in enumerate(found) for b in found[:i])
    assert all((low >= 0.0).all() and (top <= PAGE).all() for low, top in found)


def test_a_label_alone_stands_next_to_its_place_without_a_leader():
    label = Label(np.array([150.0, 100.0]), np.array([30.0, 6.0]))
    (middle,) = place([label], PAGE, np.zeros((0, 2)), NOTHING)
    assert leader(label, middle) is None


def test_a_label_keeps_off_lines_and_edges():
    label = Label(np.array([150.0, 100.0]), np.array([30.0, 6.0]))
    line = np.column_stack([np.linspace(0.0, 300.0, 100), np.full(100, 108.0)])
    (middle,) = place([label], PAGE, line, NOTHING)
    assert abs(middle[1] - 108.0) > 6.0
    square = np.array([[[140.0, 60.0], [200.0, 60.0], [200.0, 120.0]], [[140.0, 60.0], [200.0, 120.0], [140.0, 120.0]]])
    (middle,) = place([label], PAGE, np.zeros((0, 2)), Shapes(PAGE, [square]))
    assert apart((middle - label.half, middle + label.half), (np.array([140.0, 60.0]), np.array([200.0, 120.0])))


@pytest.mark.parametrize(
    ("name", "pose"),
    [("patu655", (0.17, -0.7)), ("patu655", (0.9, -1.8)), ("patu655", (0.5, -0.6)), ("excavator", None),
     ("loader", None), ("patu655-telescope", None)],
)  # fmt: skip
def test_labels_of_an_overview_do_not_overlap(name, pose):
    crane = Crane.load(name)
    if pose:
        crane = replace(crane, initial=replace(crane.initial, pose=pose))
    figure = overview(crane, [crane.machine.cylinders[0].name])
    figure.canvas.draw()
    (axes,) = figure.axes
    found = [text.get_window_extent() for text in axes.texts if text.get_text()]
    assert all(axes.bbox.contains(b.x0, b.y0) and axes.bbox.contains(b.x1, b.y1) for b in found)
    assert not [1 for i, a in enumerate(found) for b in found[:i] if a.padded(-1.0).overlaps(b.padded(-1.0))]
