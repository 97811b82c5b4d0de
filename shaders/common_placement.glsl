// One coordinate of a vertex in view, computed with a row of view_from_model.
//
// The translation, the largest term, is added last, so that only this addition rounds in steps of the sum's size.

float placed(vec4 row, vec3 position) {
    precise float coordinate = fma(row.x, position.x, fma(row.y, position.y, row.z * position.z)) + row.w;
    return coordinate;
}
