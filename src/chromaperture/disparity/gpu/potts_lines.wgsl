// Belief propagation along all rows, or all columns, there and back; see `stages/planes.py`. A workgroup has one line;
// its invocations share the choices. Beliefs hold the cost and all messages.

@group(0) @binding(0) var<storage, read_write> beliefs: array<f32>;  // (h, w, planes)
@group(0) @binding(1) var<storage, read_write> ahead: array<f32>;  // messages from the pixel before
@group(0) @binding(2) var<storage, read_write> back: array<f32>;  // messages from the pixel behind
@group(0) @binding(3) var<storage, read> links: array<f32>;  // (2, h, w): to the right, downwards
@group(0) @binding(4) var<storage, read> plane_count: array<u32>;

var<workgroup> parts: array<f32, 64>;
var<workgroup> eighths: array<f32, 8>;

fn least_of_all(own: f32, local: u32) -> f32 {
    parts[local] = own;
    workgroupBarrier();
    if (local < 8u) {
        var least = parts[local * 8u];
        for (var k = 1u; k < 8u; k++) { least = min(least, parts[local * 8u + k]); }
        eighths[local] = least;
    }
    workgroupBarrier();
    var least = eighths[0];
    for (var k = 1u; k < 8u; k++) { least = min(least, eighths[k]); }
    return least;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let line = group.x;
    let number = plane_count[0];
    let steps = select(height, width, along_x) - 1u;
    let first = select(line, line * width, along_x);
    let stride = select(width, 1u, along_x);
    let link_plane = select(width * height, 0u, along_x);
    for (var s = 0u; s < 2u * steps; s++) {
        let forwards = s < steps;
        let place = select(2u * steps - s, s, forwards);
        let here = first + place * stride;
        let next = select(here - stride, here + stride, forwards);
        let penalty = links[link_plane + min(here, next)];
        var least = 1.0e30;
        for (var k = local; k < number; k += 64u) {
            let at = here * number + k;
            least = min(least, beliefs[at] - select(ahead[at], back[at], forwards));
        }
        least = least_of_all(least, local);
        for (var k = local; k < number; k += 64u) {
            let at = here * number + k;
            let to = next * number + k;
            if (forwards) {
                let message = min(beliefs[at] - back[at] - least, penalty);
                beliefs[to] += message - ahead[to];
                ahead[to] = message;
            } else {
                let message = min(beliefs[at] - ahead[at] - least, penalty);
                beliefs[to] += message - back[to];
                back[to] = message;
            }
        }
    }
}
