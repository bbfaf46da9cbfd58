// Belief propagation along all rows, or all columns, there and back; see `stages/planes.py`. The invocations
// of a line share its choices. Beliefs hold the cost and all messages.

@group(0) @binding(0) var<storage, read_write> beliefs: array<f32>;  // (h, w, planes)
@group(0) @binding(1) var<storage, read_write> ahead: array<f32>;  // messages from the pixel before
@group(0) @binding(2) var<storage, read_write> back: array<f32>;  // messages from the pixel behind
@group(0) @binding(3) var<storage, read> links: array<f32>;  // (2, h, w): to the right, downwards
@group(0) @binding(4) var<storage, read> plane_count: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let own_line = group.x * (64u / lanes) + local / lanes;
    let used = own_line < select(width, height, along_x);
    let line = select(0u, own_line, used);
    let lane = local % lanes;
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
        for (var k = lane; k < number; k += lanes) { least = min(least, beliefs[here + k] - back[here + k]); }
        least = least_of_all(least, local);
        for (var k = select(number, lane, used); k < number; k += lanes) {
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
        for (var k = lane; k < number; k += lanes) { least = min(least, beliefs[here + k] - ahead[here + k]); }
        least = least_of_all(least, local);
        for (var k = select(number, lane, used); k < number; k += lanes) {
            let message = min(beliefs[here + k] - ahead[here + k] - least, penalty);
            beliefs[next + k] += message - back[next + k];
            back[next + k] = message;
        }
    }
}
