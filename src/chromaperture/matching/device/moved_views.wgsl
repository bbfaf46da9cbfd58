// Views sampled where the lens shows them, between four pixels each, in whole units of light: weights are whole parts, so
// that sums are exact. See `matching/moved_views.py`.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (at least K, h, w)
@group(0) @binding(1) var<storage, read> moves: array<u32>;  // (K, h, w): parts of a px along x and y, 16 bits each
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> sampled: array<f32>;  // (K, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= view_count * width * height) { return; }
    let pixel = i % (width * height);
    let both = bitcast<i32>(moves[i]);
    let parts = i32(move_parts);
    let place = parts * vec2i(i32(pixel % width), i32(pixel / width)) + vec2i((both << 16u) >> 16u, both >> 16u);
    let first = vec2i(floor(vec2f(place) / f32(parts)));
    let part = vec2f(place - parts * first);
    let base = i - pixel;
    let upper = base + inside(first.y, height) * width;
    let lower = base + inside(first.y + 1i, height) * width;
    let left = inside(first.x, width);
    let right = inside(first.x + 1i, width);
    let rest = f32(parts) - part;
    let sum = rest.y * (rest.x * planes[upper + left] + part.x * planes[upper + right])
        + part.y * (rest.x * planes[lower + left] + part.x * planes[lower + right]);
    sampled[i] = stats[UNIT] * round(stats[UNIT + 1u] * (sum / f32(parts * parts)));
}
