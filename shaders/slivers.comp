#version 450 core
// Hides points of this eye's view behind what is narrower than a pixel of the other view.
//
// The other view's disparity map has samples at pixel centres only. A spoke or a leaf can fall between two centres. So can
// the point that we ask about, but only horizontally: it is always on the middle of a row. Narrow triangles of the other
// view are therefore cut along the middles of rows. A cut is an interval of columns, and hides the points behind it.
//
// Three steps, each with a work list for the next one. TRIANGLES lists narrow triangles. CUTS lists their cuts that may
// hide a point. POINTS tests two kinds of points against the cuts: undecided ones, and ones that visibility.comp took for
// visible because the surface seems continuous.

#include "common_constants.glsl"
#include "common_masks.glsl"
#include "common_silhouette.glsl"

#define TRIANGLES 0
#define CUTS 1
#define POINTS 2

layout(local_size_x = 64) in;

layout(binding = 0) uniform sampler2D own_disparity;
layout(binding = 1) uniform sampler2D other_disparity;

// Triangles of one instance that follow each other.
struct Run {
    uint instance;
    uint first_triangle;
    uint triangles;
    uint fronts_only;
};

layout(std430, binding = 4) readonly buffer Runs { Run runs[]; };
// Counts go on where a list is full, so that the program can make it longer.
layout(std430, binding = 6) buffer Narrow {
    uint narrow_count;
    uint narrow_unused[3];
    uvec4 narrow[];  // triangle, instance, first row, and the one after the last
};
layout(std430, binding = 7) buffer Cuts {
    uint cut_count;
    uint cut_unused[3];
    uvec4 cuts[];    // triangle, instance, row, and whether it stands before what is shown
};

vec2 on_image(vec3 corner) {
    return focal_px * corner.xy / corner.z + centre_px;
}

#if STEP == TRIANGLES
uniform uint run_count;

// Largest width of a narrow triangle. Most wider triangles show at a pixel's centre, from which visibility.comp follows
// them. With 1.5, masks of half the size are right in 0.002 % more of the pixels, and take 1.2 times as long.
const float WIDEST_PX = 0.75;
// Largest number of rows in an entry of the list, so that several invocations share a tall triangle.
const uint MOST_ROWS = 4u;

// The rows whose middles cut a narrow triangle, the first and the one after the last.
uvec2 rows_of(vec3 corner_a, vec3 corner_b, vec3 corner_c) {
    vec2 a = on_image(corner_a), b = on_image(corner_b), c = on_image(corner_c);
    vec2 least = min(min(a, b), c), most = max(max(a, b), c), last = vec2(textureSize(own_disparity, 0) - 1);
    // Twice the area is the widest cut times the height.
    vec2 ab = b - a, ac = c - a;
    bool is_narrow = abs(ab.x * ac.y - ac.x * ab.y) < WIDEST_PX * (most.y - least.y);
    bool in_view = most.x > -0.5 && least.x < last.x + 0.5 && least.y <= last.y && most.y >= 0.0;
    // A triangle that crosses the near plane belongs to a wall.
    bool in_front = min(min(corner_a.z, corner_b.z), corner_c.z) >= near_m;
    vec2 rows = vec2(max(ceil(least.y), 0.0), min(floor(most.y), last.y) + 1.0);
    return is_narrow && in_view && in_front ? uvec2(rows) : uvec2(0u);
}

void main() {
    for (uint number = gl_WorkGroupID.x; number < run_count; number += gl_NumWorkGroups.x) {
        Run run = runs[number];
        Instance instance = instance_at(run.instance);
        for (uint k = gl_LocalInvocationID.x; k < run.triangles; k += gl_WorkGroupSize.x) {
            uint triangle = run.first_triangle + k;
            vec3 a = corner_of(instance, triangle, 0), b = corner_of(instance, triangle, 1);
            vec3 c = corner_of(instance, triangle, 2);
            bool shown = run.fronts_only == 0u || dot(cross(b - a, c - a), a) < 0.0;
            uvec2 rows = shown ? rows_of(a, b, c) : uvec2(0u);
            for (uint row = rows.x; row < rows.y; row += MOST_ROWS) {
                uint at = atomicAdd(narrow_count, 1u);
                if (at < uint(narrow.length())) {
                    narrow[at] = uvec4(triangle, run.instance, row, min(row + MOST_ROWS, rows.y));
                }
            }
        }
    }
}
#endif

#if STEP == CUTS || STEP == POINTS
struct Cut {
    vec3 a, b, c;
    int row;
    float begin, end;  // columns
};

void widen(inout Cut cut, vec2 from, vec2 to) {
    float row = float(cut.row);
    if ((from.y > row) != (to.y > row)) {
        float column = mix(from.x, to.x, (row - from.y) / (to.y - from.y));
        cut.begin = min(cut.begin, column);
        cut.end = max(cut.end, column);
    }
}

Cut cut_at(Instance instance, uint triangle, uint row) {
    vec3 a = corner_of(instance, triangle, 0), b = corner_of(instance, triangle, 1), c = corner_of(instance, triangle, 2);
    Cut cut = Cut(a, b, c, int(row), 1e30, -1e30);
    vec2 on_a = on_image(a), on_b = on_image(b), on_c = on_image(c);
    widen(cut, on_a, on_b);
    widen(cut, on_b, on_c);
    widen(cut, on_c, on_a);
    return cut;
}

float disparity_of(Cut cut, float column) {
    return focal_baseline * inverse_depth_at(cut.a, cut.b, cut.c, vec2(column, cut.row)) - doffs_px;
}

float shown_at(int column, int row) {
    int last = textureSize(other_disparity, 0).x - 1;
    return or_far(texelFetch(other_disparity, ivec2(clamp(column, 0, last), row), 0).r);
}

uint invocations() {
    return gl_NumWorkGroups.x * gl_WorkGroupSize.x;
}
#endif

#if STEP == CUTS
layout(binding = 6) uniform usampler2D open_columns;

// Whether a point that is open may lie behind a cut.
bool is_open(Cut cut) {
    ivec2 last = textureSize(own_disparity, 0) - 1;
    ivec2 at = clamp(ivec2(floor(vec2(cut.begin, cut.end))), ivec2(0), ivec2(last.x));
    uint bits = texelFetch(open_columns, ivec2(at.x / 32, cut.row), 0).r >> uint(at.x % 32);
    // Few cuts reach into the next 32 columns; these are taken for open.
    return (bits & ((2u << uint(min(at.y - at.x, 30))) - 1u)) != 0u || at.y / 32 != at.x / 32;
}

// Whether a cut is nearer than the surfaces that the pixels beside it show, and does not continue them.
bool stands_before(Cut cut) {
    float middle = 0.5 * (cut.begin + cut.end), left = floor(middle), disparity_px = disparity_of(cut, middle);
    vec2 beside = vec2(shown_at(int(left), cut.row), shown_at(int(left) + 1, cut.row));
    return disparity_px > min(beside.x, beside.y) + BEND_PX && !goes_on(disparity_px, middle - left, beside);
}

void main() {
    for (uint item = gl_GlobalInvocationID.x; item < min(narrow_count, uint(narrow.length())); item += invocations()) {
        uvec4 listed = narrow[item];
        Instance instance = instance_at(listed.y);
        for (uint row = listed.z; row < listed.w; ++row) {
            Cut cut = cut_at(instance, listed.x, row);
            bool before = stands_before(cut);
            if (cut.begin <= cut.end && (before || is_open(cut))) {
                uint at = atomicAdd(cut_count, 1u);
                if (at < uint(cuts.length())) {
                    cuts[at] = uvec4(listed.xy, row, before ? 1u : 0u);
                }
            }
        }
    }
}
#endif

#if STEP == POINTS
layout(binding = 0, r8ui) uniform uimage2D visibility;

layout(binding = 7) uniform usampler2D open_first;
layout(binding = 8) uniform usampler2D open_next;

// Largest distance, in columns, of a point from where it would be on a surface that continues.
const int AROUND = 2;

// Hide a pixel's point, if it lies between two columns and behind a cut.
void hide(Cut cut, int column, float first, float end) {
    ivec2 pixel = ivec2(column, cut.row);
    float disparity_px = texelFetch(own_disparity, pixel, 0).r;
    float target = target_of(float(column), disparity_px);
    bool inside = target > first && target < end && target >= cut.begin && target <= cut.end;
    if (inside && is_before(least_inverse_depth_at(cut.a, cut.b, cut.c, vec2(target, cut.row)), disparity_px)
        && imageLoad(visibility, pixel).r == VISIBLE) {
        imageStore(visibility, pixel, uvec4(OCCLUDED));
    }
}

void main() {
    int last = textureSize(own_disparity, 0).x - 1;
    for (uint item = gl_GlobalInvocationID.x; item < min(cut_count, uint(cuts.length())); item += invocations()) {
        uvec4 listed = cuts[item];
        Cut cut = cut_at(instance_at(listed.y), listed.x, listed.z);
        float nearest_px = max(disparity_of(cut, cut.begin), disparity_of(cut, cut.end));
        for (int beside = max(int(floor(cut.begin)), 0); beside <= min(int(floor(cut.end)) + 1, last); ++beside) {
            float shown_px = shown_at(beside, cut.row);
            int about = int(floor(target_of(float(beside), -shown_px)));
            bool before = listed.w != 0u && nearest_px > shown_px + BEND_PX;
            for (int column = max(about - AROUND, 0); before && column <= min(about + 1 + AROUND, last); ++column) {
                hide(cut, column, float(beside) - 1.0, float(beside) + 1.0);
            }
            uint open = texelFetch(open_first, ivec2(beside, cut.row), 0).r;
            while (open != 0u) {
                hide(cut, int(open) - 1, float(beside) - 1.0, float(beside) + 1.0);
                open = texelFetch(open_next, ivec2(open - 1u, cut.row), 0).r;
            }
        }
    }
}
#endif
