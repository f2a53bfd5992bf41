"""The losses of Figure 6.3: of lone contacts on the way to the grid and back, and of motion in its image."""

from conftest import load_script

import deep_contact as dc
from deep_contact.sph.start import Sph
from deep_contact.studies.starts import solved_states

transfer = load_script("figure_6_3")


def test_a_lone_contact_loses_nothing_by_sharing_and_much_by_algorithm_4():
    alone = transfer.isolated_contacts(20, seed=0)
    assert transfer.transfer_loss(alone, Sph(transfer="shared")) < 1e-12
    assert transfer.transfer_loss(alone, Sph(transfer="thesis")) > 0.1


def test_the_image_of_motion_keeps_what_sums_keep_and_energy_where_no_node_is_shared():
    """Weights of a circle sum to one, so m and m v stay; two circles on one node move alike there and lose energy."""
    states = solved_states(dc.circles_in_box(40, seed=3), steps=200, every=190)[-1:]
    apart, mixed = (transfer.motion_loss(states, Sph(spacing=d)) for d in (0.5, 4.0))
    assert max(apart["mass and momentum"], mixed["mass and momentum"], apart["energy"]) < 1e-12
    assert 1e-9 < apart["angular momentum"] < 0.01
    assert mixed["energy"] > 1e-3
    # At rest nothing is lost.
    assert max(transfer.motion_loss([dc.circles_in_box(5, seed=0)], Sph(spacing=0.5)).values()) < 1e-12
