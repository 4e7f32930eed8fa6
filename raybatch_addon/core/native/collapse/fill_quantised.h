// Links of a node of QUANTISED; its boxes come behind.
unsigned int* node = (unsigned int*)nodes.data + NODE_WORDS * (long long)i;
node[3] = (unsigned int)P[12] << 24;
for (int j = 0; j < 4; ++j) node[4 + j] = (unsigned int)P[8 + j];
