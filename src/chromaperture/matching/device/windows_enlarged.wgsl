// Windows' evidence at a pixel, bilinear between windows; beyond the last one it holds.

@group(0) @binding(3) var<storage, read> windows: array<f32>;  // (window rows, window columns, count) nats
@group(0) @binding(4) var<storage, read> usable: array<f32>;  // (h, w)

fn of_windows(x: u32, y: u32, n: u32) -> f32 {
    let left = min(x / stride, window_columns - 1u);
    let right = min(x / stride + 1u, window_columns - 1u);
    let above = min(y / stride, window_rows - 1u) * window_columns;
    let below = min(y / stride + 1u, window_rows - 1u) * window_columns;
    let share = vec2f(vec2u(x, y) % stride) / f32(stride);
    let upper = mix(windows[(above + left) * count + n], windows[(above + right) * count + n], share.x);
    let lower = mix(windows[(below + left) * count + n], windows[(below + right) * count + n], share.x);
    return usable[y * width + x] * mix(upper, lower, share.y);
}
