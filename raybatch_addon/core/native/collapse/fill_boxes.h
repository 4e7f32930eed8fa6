// Links of a node of BOXES; its planes come behind.
float* node = (float*)((char*)nodes.data + NODE_BYTES * (long long)i);
int* child = (int*)((char*)node + NODE_CHILD);
int* spare = (int*)((char*)node + NODE_SPARE);
for (int s = 0; s < 8; ++s) {
    child[s] = P[8 + s];
    spare[s] = 0;
}
