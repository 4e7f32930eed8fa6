// The vertices of a group of triangles of BOXES, by its faces.
// Row 9 of a group names its triangles; rows 0 to 8 are the coordinates of their corners.
float* rows = (float*)blocks.data + GROUP_WORDS * (long long)i;
for (int lane = 0; lane < 8; ++lane) {
    const int face = ((const int*)rows)[72 + lane];
    for (int j = 0; j < 3; ++j)
        for (int k = 0; k < 3; ++k)
            rows[8 * (3 * j + k) + lane] = face < 0 ? 0.0f : positions.data[triangles.data[face][j]][k];
}
