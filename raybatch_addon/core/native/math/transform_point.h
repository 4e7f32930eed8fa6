// The point `p` under the map `m`.
return transformed_point(m, p);
