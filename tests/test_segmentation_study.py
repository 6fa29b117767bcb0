"""How the study of segmentation judges labels: on images drawn by hand."""

import numpy as np
import pytest

from rangecam.studies.segmentation import rates

OBJECTS = np.zeros((10, 20), int)
OBJECTS[2:8, 2:8], OBJECTS[2:8, 12:18] = 1, 2


def test_labels_that_are_the_objects_are_right_whatever_their_numbers():
    labels = np.where(OBJECTS == 1, 2, np.where(OBJECTS == 2, 1, 0))
    assert rates(labels, OBJECTS) == (0.0, 0.0, 1.0)


def test_what_is_cut_in_two_is_in_several_segments_and_a_stray_pixel_is_none():
    labels = OBJECTS.copy()
    labels[2:8, 5:8] = 3
    assert rates(labels, OBJECTS) == (0.5, 0.0, pytest.approx(0.75))
    labels = OBJECTS.copy()
    labels[2, 2] = 3
    assert rates(labels, OBJECTS)[:2] == (0.0, 0.0)


def test_what_is_one_segment_shares_it_and_overlaps_by_half():
    assert rates((OBJECTS > 0).astype(int), OBJECTS) == (0.0, 1.0, pytest.approx(0.5))


def test_nothing_found_overlaps_with_nothing_and_small_objects_do_not_count():
    assert rates(np.zeros_like(OBJECTS), OBJECTS) == (0.0, 0.0, 0.0)
    small = OBJECTS.copy()
    small[0, :7] = 3
    assert rates(OBJECTS, small) == (0.0, 0.0, 1.0)
