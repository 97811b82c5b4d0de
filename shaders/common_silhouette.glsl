// Follows a surface across the image, from the centre of a pixel that shows it to a target position nearby.
//
// Depth maps know surfaces only at pixel centres. Whether a surface hides a point between the centres is decided by its
// triangles: we walk from the triangle that the pixel shows across shared edges, until we reach the target or the
// surface turns back at its silhouette.

#include "common_triangles.glsl"

const uint NO_NEIGHBOUR = 0xFFFFFFFFu;
const uint MOST_STEPS = 512u;  // maximum number of triangles to cross; in finer meshes the walk may end too early
const float NOT_COVERED = -1.0;
// Tolerance of a target position, px: column + disparity, each up to some thousands, which float32 rounds by 1e-4.
const float TARGET_ERROR_PX = 3e-4;

// The smallest 1 / Z of a triangle's plane within TARGET_ERROR_PX of a pixel position. At a grazing angle, disparity
// changes by tens of px from pixel to pixel, so without this tolerance a surface would hide its own points.
float least_inverse_depth_at(vec3 a, vec3 b, vec3 c, vec2 pixel) {
    vec3 normal = cross(b - a, c - a);
    // The derivatives of inverse_depth_at by pixel.x and pixel.y.
    vec2 per_pixel = abs(normal.xy / (focal_px * dot(normal, a)));
    return inverse_depth_at(a, b, c, pixel) - TARGET_ERROR_PX * (per_pixel.x + per_pixel.y);
}

// A walk along a surface from the centre of a pixel, the start, to a target position.
struct Trace {
    Instance instance;
    uint triangle;        // the next triangle to cross
    uint came_from;       // the previous triangle
    vec2 start;
    vec2 target;
    float reached;        // where the walk entered the triangle: 0 at the start, 1 at the target
    uint steps;
    bool ended;
    float inverse_depth;  // the result, when the walk has ended; see surface_at
};

Trace trace_from(uvec2 surface, vec2 start, vec2 target) {
    return Trace(instance_at(surface.x), surface.y, NO_NEIGHBOUR, start, target, 0.0, 0u, false, NOT_COVERED);
}

// Crosses one triangle. Callers that trace several surfaces use a single loop: llvmpipe runs eight invocations at a
// time, and in nested loops all of them would wait for the slowest invocation at each surface.
void cross_triangle(inout Trace trace) {
    vec2 path = trace.target - trace.start;
    float path_squared = dot(path, path);
    vec3 corner[3];
    uint neighbour[3];
    // The corners in the image, relative to the path: x along it, 0 at the start and 1 at the target; y across it.
    vec2 on_path[3];
    bool in_front = true;
    for (int k = 0; k < 3; ++k) {
        uvec4 bits = corner_bits(trace.triangle, k);
        corner[k] = to_view(trace.instance, position_of(bits));
        neighbour[k] = bits.w;
        in_front = in_front && corner[k].z >= near_m;
        vec2 from_start = focal_px * corner[k].xy / corner[k].z + centre_px - trace.start;
        on_path[k] = vec2(dot(from_start, path) / path_squared, from_start.y * path.x - from_start.x * path.y);
    }
    // Two of the three edges cross the line of the path. Leave by the farther one, but not back to the last triangle.
    float exit = -1e30;
    uint next = NO_NEIGHBOUR;
    for (int k = 0; k < 3; ++k) {
        vec2 from = on_path[k], to = on_path[(k + 1) % 3];
        uint across = neighbour[k];
        float crossing = mix(from.x, to.x, from.y / (from.y - to.y));
        bool crossed = (from.y > 0.0) != (to.y > 0.0) && (across != trace.came_from || across == NO_NEIGHBOUR);
        if (crossed && crossing > exit) {
            exit = crossing;
            next = across;
        }
    }
    // A triangle that crosses the near plane has no outline in the image. Assume that it covers the target.
    bool arrived = !in_front || path_squared == 0.0 || exit >= 1.0;
    // At the silhouette, the surface turns back: the walk would leave this triangle before the point where it entered.
    bool left = next == NO_NEIGHBOUR || (trace.steps > 0u && exit < trace.reached) || trace.steps + 1u == MOST_STEPS;
    trace.ended = arrived || left;
    if (arrived) {
        trace.inverse_depth = least_inverse_depth_at(corner[0], corner[1], corner[2], trace.target);
    }
    trace.reached = exit;
    trace.came_from = trace.triangle;
    trace.triangle = next;
    ++trace.steps;
}

// 1 / Z of the surface at the target position, less the tolerance of the position; NOT_COVERED if the surface ends
// before the target.
float surface_at(uvec2 surface, vec2 start, vec2 target) {
    Trace trace = trace_from(surface, start, target);
    while (!trace.ended) {
        cross_triangle(trace);
    }
    return trace.inverse_depth;
}
