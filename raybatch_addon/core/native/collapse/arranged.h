// The figures of the finished plan.
int* F = work.found.data;
F[1] = node_count;
F[2] = listed;
F[3] = levels;
F[4] = leaf_count;
F[5] = reference_count;
work.sah.data[0] = sah;
return 0;
