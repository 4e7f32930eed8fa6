// The words of a wide node, as vectors.
for (int k = 0; k < 5; ++k) {
    Bits word[4];
    for (int j = 0; j < 4; ++j) word[j].bits = node[4 * k + j];
    out.data[5ll * index + k] = wp::vec4(word[0].value, word[1].value, word[2].value, word[3].value);
}
