// A coordinate of a vertex in the view frame: the product of a row of view_from_model and the position.
//
// The translation row.w, the largest term, is added last: only this sum is rounded at the size of the result.

float view_coordinate(vec4 row, vec3 position) {
    precise float coordinate = fma(row.x, position.x, fma(row.y, position.y, row.z * position.z)) + row.w;
    return coordinate;
}
