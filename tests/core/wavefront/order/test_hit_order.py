"""The order in which hits are shaded where triangles lie in host memory."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.measure.timing import NoTimer
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.shading.bsdf.materials import MaterialRecord
from raybatch_addon.core.wavefront.order.hit_order import BINNED_MIN, HitKey, HitOrder, hit_order_bytes
from raybatch_addon.core.wavefront.rays import allocate_rays

PATHS = 5000
KEY_BITS = HitKey.TRIANGLE.value


def hits_of(triangle_count: int, device: str, rng: np.random.Generator):
    """Geometry of three instances of two meshes, and rays that hit them; the triangle of each, by slot."""
    with wp.ScopedDevice(device):
        geometry = Geometry()
        geometry.positions = wp.zeros(3 * triangle_count, dtype=wp.vec3)
        firsts, meshes = np.array([0, triangle_count // 3, triangle_count]), np.array([1, 0, 1])
        geometry.mesh_triangle_first = wp.array(firsts, dtype=int)
        geometry.instance_mesh = wp.array(meshes, dtype=int)
        rays = allocate_rays(PATHS, wp.get_device(device))
        instance = rng.integers(0, 3, PATHS)
        mesh = meshes[instance]
        primitive = rng.integers(0, np.diff(firsts)[mesh])
        rays.hit_instance.assign(instance.astype(np.int32))
        rays.hit_primitive.assign(primitive.astype(np.int32))
    return geometry, rays, firsts[mesh] + primitive


@pytest.mark.parametrize("capacity", [0, 1, 64, 1000])
@pytest.mark.parametrize("triangle_count", [7, (1 << KEY_BITS) - 1, 1 << KEY_BITS, 3_000_000])
@pytest.mark.parametrize("hit_count", [0, 1, 63, 3001])
def test_hits_follow_their_triangles(device, capacity, triangle_count, hit_count):
    """Each part holds its hits once, in the order of their triangles up to what the key leaves out."""
    if capacity == 1 and hit_count > 63:
        pytest.skip("so many parts")
    rng = np.random.default_rng(triangle_count + hit_count)
    geometry, rays, triangle = hits_of(triangle_count, device, rng)
    slots = rng.permutation(PATHS)[:hit_count]
    listed = np.full(PATHS, -1, np.int32)  # what lies behind the list is nobody's slot
    listed[:hit_count] = slots
    hits = RayList(
        wp.array(listed, dtype=int, device=device), wp.array([hit_count], dtype=int, device=device), hit_count + 40
    )
    none = wp.empty(0, dtype=MaterialRecord, device=device)
    order = HitOrder(PATHS, HitKey.TRIANGLE, geometry, none, wp.get_device(device), NoTimer(), capacity)
    seen, coarse = [], max(1, triangle_count >> KEY_BITS)
    for part in order.parts(rays, hits):
        length = min(max(0, int(part.count.numpy()[0])), part.bound)
        found = part.slots.numpy()[:length]
        assert sorted(found) == sorted(slots[len(seen) : len(seen) + length])
        assert (np.diff(triangle[found]) > -2 * coarse).all(), "not in the order of triangles"
        seen += found.tolist()
    assert len(seen) == hit_count


@pytest.mark.parametrize("hit_count", [0, 1500, 3001])
def test_hits_follow_their_materials(device, hit_count):
    """Hits of one bin lie together, each in the order that it had."""
    rng = np.random.default_rng(hit_count)
    geometry, rays, triangle = hits_of(400, device, rng)
    slots = rng.permutation(PATHS)[:hit_count]
    materials = rng.integers(0, 40, 400)  # of each triangle, alike in all instances
    bins = rng.integers(0, 300, 40)  # more than the key tells apart
    with wp.ScopedDevice(device):
        geometry.instance_slot_first = wp.zeros(3, dtype=int)
        geometry.triangle_slot = wp.array(materials, dtype=int)
        geometry.slot_materials = wp.array(np.arange(40), dtype=int)
        rows = np.zeros(40, MaterialRecord.numpy_dtype())
        rows["bin"] = bins
        records = wp.array(rows, dtype=MaterialRecord)
        hits = RayList(wp.array(slots, dtype=int), wp.array([hit_count], dtype=int), max(hit_count, BINNED_MIN))
    order = HitOrder(PATHS, HitKey.MATERIAL, geometry, records, wp.get_device(device), NoTimer())
    (part,) = order.parts(rays, hits)
    found = part.slots.numpy()[: int(part.count.numpy()[0])]
    key = np.minimum(bins[materials[triangle[slots]]], 255)
    assert (found == slots[np.argsort(key, kind="stable")]).all()


def test_few_hits_keep_their_order(device):
    """A sort of few takes longer than it saves."""
    geometry, rays, _ = hits_of(7, device, np.random.default_rng(0))
    few = RayList(wp.array([3, 1], dtype=int, device=device), wp.array([2], dtype=int, device=device), BINNED_MIN - 1)
    none = wp.empty(0, dtype=MaterialRecord, device=device)
    order = HitOrder(PATHS, HitKey.MATERIAL, geometry, none, wp.get_device(device), NoTimer())
    assert list(order.parts(rays, few)) == [few]


def test_scratch_is_what_is_reported():
    assert hit_order_bytes(1000) == 16_000
    assert hit_order_bytes(1 << 26) == hit_order_bytes(1 << 28), (
        "sorting takes no more memory however many paths are alive"
    )
