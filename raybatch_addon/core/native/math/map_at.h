// The map at `time`, of keys that lie in an array of their own.
return rounded_map(moved_map(keys.data, keys.shape[0] / KEY_FLOATS, time));
