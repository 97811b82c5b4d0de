#version 450 core
// Blends into a pixel the colour on the other side of an edge, by the share of the pixel's area on that side. If the
// pixel's centre is off the surface, this is the colour of the surface's patch, lit by the projector if LIT. If it is
// on the surface, this is the colour of the next pixel across the edge.

in vec4 seen_patch;  // patch coordinate of the edge beside this pixel, layer, mipmap level
// The edge's line in the window: unit normal n, away from the surface, and c. A position x is at a distance of
// n . x + c, px, from the edge, positive off the surface. The last component is 1 for a large patch, else 0.
flat in vec4 line;

layout(binding = 0) uniform sampler2DArray atlas;
#ifdef LARGE
layout(binding = 1) uniform sampler2DArray large_atlas;
#endif
layout(binding = 4) uniform sampler2D drawn;  // a copy of the colour before blending

#ifdef LIT
#include "common_projector.glsl"

flat in vec3 normal;  // of the surface, in the projector's frame
#endif

layout(location = 0) out vec4 colour;

// The share of a pixel's area beyond a line with normal n at this distance from the pixel's centre. Let l be the larger
// of abs(n.x) and abs(n.y), and s the smaller. A line that cuts off one corner cuts off a triangle of area
// ((l + s) / 2 - distance)^2 / (2 l s). A line through two opposite sides cuts off 1/2 - distance / l.
float share_beyond(float distance_px, vec2 n) {
    vec2 extent = abs(n);
    float longer = max(extent.x, extent.y), shorter = min(extent.x, extent.y);
    float rest = max(0.5 * (longer + shorter) - distance_px, 0.0);
    return rest > shorter ? 0.5 - distance_px / longer : rest * rest / (2.0 * longer * max(shorter, 1e-6));
}

void main() {
    float signed_px = dot(line.xy, gl_FragCoord.xy) + line.z;
    float share = share_beyond(abs(signed_px), line.xy);
    if (signed_px < 0.0) {
        // The centre of the next pixel in the direction of the larger component is always beyond the edge, since the
        // edge is within (l + s) / 2 <= l of this centre.
        ivec2 across = abs(line.x) > abs(line.y) ? ivec2(sign(line.x), 0) : ivec2(0, sign(line.y));
        ivec2 next = clamp(ivec2(gl_FragCoord.xy) + across, ivec2(0), textureSize(drawn, 0) - 1);
        colour = vec4(texelFetch(drawn, next, 0).rgb, share);
        return;
#ifdef LARGE
    } else if (line.w > 0.5) {
        colour = vec4(textureLod(large_atlas, seen_patch.xyz, round(seen_patch.w)).rgb, share);
#endif
    } else {
        colour = vec4(textureLod(atlas, seen_patch.xyz, round(seen_patch.w)).rgb, share);
    }
#ifdef LIT
    // The strip has the depth of the edge, so take the light at the edge.
    vec2 on_edge_px = gl_FragCoord.xy - signed_px * line.xy;
    colour.rgb *= light_on(point_over_depth(on_edge_px, gl_FragCoord.w), gl_FragCoord.w, normal, false);
#endif
}
