// The figures of the finished plan.
int* found = work.found.data;
found[NODE_COUNT] = node_count;
found[LISTED] = listed;
found[LEVELS] = levels;
found[LEAF_COUNT] = leaf_count;
found[REFERENCE_COUNT] = reference_count;
work.sah.data[0] = sah;
return NO_ERROR;
