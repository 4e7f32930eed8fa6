// The direction `d` under the linear part of the map `m`.
return transformed_vector(m, d);
