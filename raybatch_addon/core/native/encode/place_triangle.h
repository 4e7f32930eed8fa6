// The vertices of a triangle of QUANTISED, by its face.
float* words = (float*)blocks.data + TRIANGLE_WORDS * (long long)i;
const int face = ((const int*)words)[3];
for (int j = 0; j < 3; ++j) {
    for (int k = 0; k < 3; ++k) words[4 * j + k] = positions.data[triangles.data[face][j]][k];
    if (j > 0) words[4 * j + 3] = 0.0f;
}
