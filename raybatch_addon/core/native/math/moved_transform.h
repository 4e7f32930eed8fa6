// The map at `time`, by the keys that begin at the map `first` of `transforms`.
return rounded_map(moved_map((const float*)(transforms.data + first), steps, time));
