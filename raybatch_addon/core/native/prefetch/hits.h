// Brings what a surface's vertex reads of triangles into a CPU's caches, for paths of a list that come after index `i`:
// such reads are far apart, and one leads to the next. Triangles that come later get their indices of corners, normals
// and material; those that come sooner, whose indices are there by now, their corners. A GPU waits by other threads.
#if !defined(__CUDA_ARCH__)
auto triangle_at = [&](int index) {
    if (index >= count) return -1;
    const int slot = slots.data[index], instance = rays.hit_instance.data[slot];
    if (instance < 0) return -1;
    return geometry.mesh_triangle_first.data[geometry.instance_mesh.data[instance]] + rays.hit_primitive.data[slot];
};
const bool is_indexed = geometry.triangles.shape[0] > 0;
auto fetch_corners = [&](int first, int second, int third) {
    __builtin_prefetch(geometry.positions.data + first);
    __builtin_prefetch(geometry.positions.data + second);
    __builtin_prefetch(geometry.positions.data + third);
};
const int later = triangle_at(i + LATER), sooner = triangle_at(i + SOONER);
if (later >= 0) {
    if (is_indexed) __builtin_prefetch(geometry.triangles.data + later);
    if (geometry.corner_normals.shape[0] > 0) {
        __builtin_prefetch(geometry.corner_normals.data + 3 * later);
        __builtin_prefetch(geometry.corner_normals.data + 3 * later + 2);
    }
    if (geometry.triangle_slot.shape[0] > 0) __builtin_prefetch(geometry.triangle_slot.data + later);
    if (geometry.instancing) {
        __builtin_prefetch(geometry.instance_transform.data + rays.hit_instance.data[slots.data[i + LATER]]);
    }
}
if (sooner >= 0) {
    if (is_indexed) {
        const wp::vec3i corners = geometry.triangles.data[sooner];
        fetch_corners(corners[0], corners[1], corners[2]);
    } else {
        fetch_corners(3 * sooner, 3 * sooner + 1, 3 * sooner + 2);
    }
}
#endif
