// The vertices of a group of triangles of BOXES, by its faces: a row for each coordinate of each corner.
char* group = (char*)blocks.data + GROUP_BYTES * (long long)i;
const int* faces = (const int*)(group + GROUP_FACE);
float* rows = (float*)group;
for (int lane = 0; lane < 8; ++lane) {
    const int face = faces[lane];
    for (int j = 0; j < 3; ++j)
        for (int k = 0; k < 3; ++k)
            rows[8 * (3 * j + k) + lane] = face < 0 ? 0.0f : positions.data[triangles.data[face][j]][k];
}
