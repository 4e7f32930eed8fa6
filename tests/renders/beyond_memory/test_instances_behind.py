"""More instances than a budget has room for: what is known of them lies behind the device, and the film is the same."""

import re
from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core import host_memory
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.scene.description import Scene
from tests.renders.beyond_memory.least_budget import CHECKED, ESTIMATOR
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

COUNT = 1500


def crowd() -> Scene:
    """Balls and boxes at random, turned and squeezed, on a floor."""
    rng = np.random.default_rng(3)
    objects = [(scenes.sphere("ball", 8, 5), scenes.diffuse()), (scenes.box("box", 1.0), scenes.diffuse(0.3))]
    made = scenes.scene(
        [
            (scenes.plane("floor", 9), scenes.IDENTITY, scenes.diffuse(0.6)),
            *((mesh, scenes.IDENTITY, look) for mesh, look in objects for _ in range(COUNT // 2)),
        ],
        view=scenes.camera(eye=(0.4, -6, 2.2), aspect=4 / 3),
        frame=scenes.Frame(16, 12),
        world=(0.3, 0.4, 0.6),
        lights=[scenes.sun(2.0, 0.05, scenes.look_at((1, -1, 3), (0, 0, 0)))],
    )
    transform = np.array(made.instances.transform)
    transform[1:, :, :3] = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0] * rng.uniform(0.05, 0.3, (COUNT, 1, 3))
    transform[1:, :, 3] = rng.uniform((-4, -4, 0), (4, 4, 2), (COUNT, 3))
    return replace(made, instances=replace(made.instances, transform=transform.astype(np.float32)))


@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("mapped_least", [1, 1 << 26])
def test_no_schedule_changes_the_film(session, store, mapped_least, monkeypatch):
    monkeypatch.setattr(host_memory, "MAPPED_LEAST", mapped_least)
    scene, rng = crowd(), np.random.default_rng(mapped_least)
    expected = session.render(scene, ESTIMATOR.replace(batching="OFF")).passes
    paged = ESTIMATOR.replace(**CHECKED, geometry_store=store)
    with pytest.raises(OutOfMemoryError, match="1,501 instances: .* bytes are enough") as error:
        session.render(scene, paged.replace(geometry_budget=1))
    least = int(re.findall(r"([\d,]+) bytes are enough", str(error.value))[0].replace(",", ""))
    assert least > 0
    behind = []
    for more in (0, *sorted(rng.integers(1, 400_000, 3).tolist())):
        film = session.render(scene, paged.replace(geometry_budget=least + more))
        for name, values in expected.items():
            assert np.array_equal(film.passes[name].view(np.int32), values.view(np.int32)), (name, more)
        tree = film.statistics["tree"]
        if "pages" in tree:
            behind.append(tree.get("records_behind", 0))
            assert film.statistics["resident_peak"] <= least + more
    assert behind[0] >= 80 * COUNT and behind == sorted(behind, reverse=True)
