// Adds windows' evidence to every pixel's, bilinearly; beyond the last window it holds.

@group(0) @binding(0) var<storage, read> windows: array<f32>;  // (window rows, window columns, count) nats
@group(0) @binding(1) var<storage, read> usable: array<f32>;  // (h, w)
@group(0) @binding(2) var<storage, read_write> likelihood: array<f32>;  // (h, w, count)

fn at(row: u32, column: u32, label: u32) -> f32 {
    return windows[(min(row, window_rows - 1u) * window_columns + min(column, window_columns - 1u)) * count + label];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = group.x + group.y * groups.x;
    if (pixel >= width * height) { return; }
    let place = vec2u(pixel % width, pixel / width);
    let share = vec2f(place % stride) / f32(stride);
    let column = place.x / stride;
    let row = place.y / stride;
    for (var n = local; n < count; n += 64u) {
        let upper = mix(at(row, column, n), at(row, column + 1u, n), share.x);
        let lower = mix(at(row + 1u, column, n), at(row + 1u, column + 1u, n), share.x);
        likelihood[pixel * count + n] += usable[pixel] * mix(upper, lower, share.y);
    }
}
