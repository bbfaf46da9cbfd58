// The form of `potts_lines.wgsl` for a device in software, where the barriers of a step take ten times as long as the
// step: one invocation has a line alone.

@group(0) @binding(0) var<storage, read_write> beliefs: array<f32>;  // (h, w, planes)
@group(0) @binding(1) var<storage, read_write> ahead: array<f32>;  // messages from the pixel before
@group(0) @binding(2) var<storage, read_write> back: array<f32>;  // messages from the pixel behind
@group(0) @binding(3) var<storage, read> links: array<f32>;  // (2, h, w): to the right, downwards
@group(0) @binding(4) var<storage, read> plane_count: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let line = group.x * 64u + local;
    if (line >= select(width, height, along_x)) { return; }
    let number = plane_count[0];
    let steps = select(height, width, along_x) - 1u;
    let first = select(line, line * width, along_x);
    let stride = select(width, 1u, along_x);
    let link_plane = select(width * height, 0u, along_x);
    // Two walks with texts of their own: software takes both sides of a branch.
    for (var s = 0u; s < steps; s++) {
        let here = (first + s * stride) * number;
        let next = here + stride * number;
        let penalty = links[link_plane + first + s * stride];
        var least = 1.0e30;
        for (var k = 0u; k < number; k++) { least = min(least, beliefs[here + k] - back[here + k]); }
        for (var k = 0u; k < number; k++) {
            let message = min(beliefs[here + k] - back[here + k] - least, penalty);
            beliefs[next + k] += message - ahead[next + k];
            ahead[next + k] = message;
        }
    }
    for (var s = steps; s > 0u; s--) {
        let here = (first + s * stride) * number;
        let next = here - stride * number;
        let penalty = links[link_plane + first + (s - 1u) * stride];
        var least = 1.0e30;
        for (var k = 0u; k < number; k++) { least = min(least, beliefs[here + k] - ahead[here + k]); }
        for (var k = 0u; k < number; k++) {
            let message = min(beliefs[here + k] - ahead[here + k] - least, penalty);
            beliefs[next + k] += message - back[next + k];
            back[next + k] = message;
        }
    }
}
