// The windows of `windows_x.wgsl` joined along y in the same way: deviations of the means, and the gain, 1 / standard
// deviation, of every sample. Deviations fade `reach` rows beyond the lower border.

@group(0) @binding(0) var<storage, read> along_x: array<vec2f>;  // (rows, columns + reach, E): mean, variance
@group(0) @binding(1) var<storage, read> phases: array<vec4f>;  // (E, 2): four taps; the phase along y
@group(0) @binding(2) var<storage, read> views: array<vec4f>;  // (Ey, 2): four taps; the view
@group(0) @binding(3) var<storage, read> stats: array<f32>;
@group(0) @binding(4) var<storage, read_write> deviations: array<vec2f>;  // (rows + reach, columns, E): forward, backward
@group(0) @binding(5) var<storage, read_write> gains: array<f32>;  // (rows + reach, columns, E)

fn joined(state: vec2f, here: vec2f) -> vec2f {
    let apart = here.x - state.x;
    let variance = decay * (state.y + (1.0 - decay) * apart * apart) + (1.0 - decay) * here.y;
    return vec2f(state.x + (1.0 - decay) * apart, variance);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let length = row_count + reach;
    let blocks = (length + block - 1u) / block;
    let pitch = columns * entry_count;
    if (i >= blocks * pitch) { return; }
    let column = i % pitch;
    let first = (i / pitch) * block;
    let end = min(first + block, length);
    let last = min(end + reach, length) - 1u;
    let view = u32(views[2u * u32(phases[2u * (column % entry_count) + 1u].x) + 1u].x);
    let floor_ = relative_epsilon * stats[VARIANCE + view] + 1.0e-30;
    let source_pitch = (columns + reach) * entry_count;
    var beyond: array<vec2f, reach>;  // the block; its own part waits in `deviations` and `gains`
    let begin = max(first, reach) - reach;
    var state = along_x[min(begin, row_count - 1u) * source_pitch + column];
    for (var y = begin; y <= last; y++) {
        let here = along_x[min(y, row_count - 1u) * source_pitch + column];
        let apart = here.x - state.x;
        state = joined(state, here);
        if (y >= end) {
            beyond[y - end] = state;
        } else if (y >= first) {
            deviations[y * pitch + column] = vec2f(deviation_unit * apart, state.x);
            gains[y * pitch + column] = state.y;
        }
    }
    for (var y = last + 1u; y > end; y--) { state = joined(state, beyond[y - 1u - end]); }
    for (var y = end; y > first; y--) {
        let at = (y - 1u) * pitch + column;
        let here = deviations[at];
        deviations[at].y = deviation_unit * (here.y - state.x);
        state = joined(state, vec2f(here.y, gains[at]));
        gains[at] = inverseSqrt(state.y + floor_);
    }
}
