// The bits of `x` as a RESULT, which is as large.
RESULT result;
memcpy(&result, &x, sizeof(result));
return result;
