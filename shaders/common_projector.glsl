// The light on a surface: ambient light, and the pattern of a projector where it reaches the surface.

// Packed by semisynth_gl/render/projector_light.py.
layout(std140, binding = 1) uniform ProjectedLight {
    mat4 projector_from_window;  // of x, y, 1 and 1 / Z, to a point over Z
    vec2 middle_px;              // of the pattern
    float projector_focal_px;
    float power;
    float ambient;
};

layout(binding = 2) uniform sampler2D pattern;
layout(binding = 3) uniform sampler2D reached_m;  // depth of what the projector sees in each of its pixels

// Depths from two matrices differ by rounding.
const float SAME_DEPTH = 1.0001;

// A point in the projector's frame, over Z in the eye's frame, from its position in the window and 1 / Z.
vec3 over_depth_at(vec2 window_px, float inverse_depth) {
    return (projector_from_window * vec4(window_px, 1.0, inverse_depth)).xyz;
}

// The light on that point of a surface; the normal, in the projector's frame, has any length.
float light_on(vec3 over_depth, float inverse_depth, vec3 normal, bool is_sky) {
    vec3 point = over_depth / inverse_depth;
    vec2 place_px = projector_focal_px * over_depth.xy / over_depth.z + middle_px;
    vec2 size = vec2(textureSize(pattern, 0));
    vec2 place = (place_px + 0.5) / size;
    // A pixel's centre lies between four of the projector's. The depth of a plane, or of what bulges towards the
    // projector, is nowhere between them larger than the largest of the four, so no surface shades itself.
    vec4 around = textureGather(reached_m, place);
    float farthest_m = max(max(around.x, around.y), max(around.z, around.w));
    bool inside = all(greaterThanEqual(place, vec2(0.0))) && all(lessThan(place, vec2(1.0)));
    bool reached = over_depth.z > 0.0 && inside && point.z <= farthest_m * SAME_DEPTH;
    float square_m = dot(point, point);
    float facing = abs(dot(normal, point)) / max(sqrt(dot(normal, normal) * square_m), 1e-30);
    // A sheet may hide its lit side from the eye. The way from the eye to the point, over Z, is the way from the
    // projector to the point less the way from the projector to the eye, the last column.
    vec3 seen_along = over_depth - projector_from_window[3].xyz * inverse_depth;
    bool same_side = dot(normal, point) * dot(normal, seen_along) > 0.0;
    // The sky is too far away.
    bool lit = reached && same_side && !is_sky;
    return ambient + (lit ? power * textureLod(pattern, place, 0.0).r * facing / square_m : 0.0);
}
