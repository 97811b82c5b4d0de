// One coordinate of a vertex, by a row of view_from_model.
//
// The translation, which is the largest term, comes last: then only the last addition rounds in its steps.

float placed(vec4 row, vec3 position) {
    precise float coordinate = fma(row.x, position.x, fma(row.y, position.y, row.z * position.z)) + row.w;
    return coordinate;
}
