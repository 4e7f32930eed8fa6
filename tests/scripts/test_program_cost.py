"""Long shader programs give what they fold to by hand."""

import dataclasses

import numpy as np
import pytest
from benchmarking import program_cost

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings


@pytest.mark.usefixtures("general_kernels")
def test_a_chain_of_500_nodes_is_one_node_folded_by_hand(session):
    chain, folded, _ = (dataclasses.replace(scene, frame=Frame(16, 16)) for scene in program_cost.scenes_of(500))
    assert len(chain.materials[0].program.instructions) > 500 > 10 > len(folded.materials[0].program.instructions)
    assert chain.materials[0].program.register_count < 16
    settings = RenderSettings(sample_count=4, bounce_max=0)
    pictures = [session.render(scene, settings).passes["Combined"][..., :3] for scene in (chain, folded)]
    assert pictures[0].std() > 0.01
    # each of 500 nodes rounds twice, relatively by 2^-24 of numbers near 1
    assert np.abs(pictures[0] - pictures[1]).max() < 500 * 2 * 2.0**-24 * 2


def test_nothing_is_measured_of_nothing(capsys):
    assert program_cost.main(["--nodes", "0"]) == 1 and "must be at least 1" in capsys.readouterr().err
