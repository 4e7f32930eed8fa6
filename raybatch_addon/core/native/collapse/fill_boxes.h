// Links of a node of BOXES; its planes come behind.
float* node = (float*)nodes.data + NODE_WORDS * (long long)i;
for (int s = 0; s < 8; ++s) {
    ((int*)node)[48 + s] = P[8 + s];
    ((int*)node)[56 + s] = 0;
}
