// Mean and variance of the views, moved by the disparity that was found, and of their mean, in squares of `cell` px
// (quality "paper"), as `unlike_views.py`.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (K + 2, H, W), of which the views
@group(0) @binding(1) var<storage, read> peaks: array<f32>;  // (3, H, W), of which the disparity
@group(0) @binding(2) var<storage, read_write> moments: array<vec4f>;  // (2, rows, columns): views first, their mean last

// Linear between pixels.
fn view_at(view: u32, place: vec2f) -> f32 {
    let held = clamp(place, vec2f(), vec2f(f32(width - 1u), f32(height - 1u)));
    let before = vec2u(held);
    let after = min(before + 1u, vec2u(width - 1u, height - 1u));
    let part = held - vec2f(before);
    let above = (view * height + before.y) * width;
    let below = (view * height + after.y) * width;
    return mix(
        mix(planes[above + before.x], planes[above + after.x], part.x),
        mix(planes[below + before.x], planes[below + after.x], part.x), part.y
    );
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= columns * rows) { return; }
    var first = vec4f();  // differences from it are exact where there is little texture
    var sums = vec4f();
    var squares = vec4f();
    for (var n = 0u; n < cell * cell; n++) {
        let x = min(cell * (i % columns) + n % cell, width - 1u);
        let y = min(cell * (i / columns) + n / cell, height - 1u);
        let disparity = peaks[y * width + x];
        let moved = select(0.0, disparity, is_known(disparity));
        var seen = vec4f();
        for (var k = 0u; k < view_count; k++) {
            let direction = vec2f(directions[2u * k], directions[2u * k + 1u]);
            seen[k] = view_at(k, vec2f(f32(x), f32(y)) + moved * direction);
            seen.w += seen[k] / f32(view_count);
        }
        if (n == 0u) { first = seen; }
        sums += seen - first;
        squares += (seen - first) * (seen - first);
    }
    let away = sums / f32(cell * cell);
    moments[i] = first + away;
    moments[columns * rows + i] = squares / f32(cell * cell) - away * away;
}
