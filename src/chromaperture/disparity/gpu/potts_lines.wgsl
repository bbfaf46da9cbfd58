// Belief propagation along all rows, or all columns, there and back; see `stages/planes.py`. The 64 invocations of a
// workgroup share the choices of a line, each has the same ones at every pixel. Beliefs hold the cost and all messages.
// A step computes little and would wait for the memory: what it needs is read `ahead` steps before, and what the next
// one needs of it stays in registers.

@group(0) @binding(0) var<storage, read_write> beliefs: array<f32>;  // (h, w, planes)
@group(0) @binding(1) var<storage, read_write> messages_ahead: array<f32>;  // from the pixel before
@group(0) @binding(2) var<storage, read_write> messages_back: array<f32>;  // from the pixel behind
@group(0) @binding(3) var<storage, read> links: array<f32>;  // (2, h, w): to the right, downwards
@group(0) @binding(4) var<storage, read> plane_count: array<u32>;

const length = select(height, width, along_x);

var<workgroup> parts: array<f32, 128>;  // for this step and, at the other half, for the next one
var<workgroup> eighths: array<f32, 16>;

// The least of a line's choices, through shared memory.
fn least_of_all(own: f32, local: u32, s: u32) -> f32 {
    let half = (s & 1u) * 64u;
    let half_of_eighths = (s & 1u) * 8u;
    parts[half + local] = own;
    workgroupBarrier();
    if (local < 8u) {
        var least = parts[half + local * 8u];
        for (var k = 1u; k < 8u; k++) { least = min(least, parts[half + local * 8u + k]); }
        eighths[half_of_eighths + local] = least;
    }
    workgroupBarrier();
    var least = eighths[half_of_eighths];
    for (var k = 1u; k < 8u; k++) { least = min(least, eighths[half_of_eighths + k]); }
    return least;
}

// Pixel of a line; counted from its end on the way back.
fn pixel_of(step: u32, line: u32, is_back: bool) -> u32 {
    let inside = min(step, length - 1u);
    let along = select(inside, length - 1u - inside, is_back);
    return select(line + along * width, line * width + along, along_x);
}

// One way. What was sent this way before is replaced; what came the other way is not sent back.
fn walk(line: u32, local: u32, is_back: bool) {
    let number = plane_count[0];
    let link_plane = select(width * height, 0u, along_x);
    var beliefs_read: array<f32, ahead * held>;
    var sent_read: array<f32, ahead * held>;
    var returned_read: array<f32, ahead * held>;
    var penalties: array<f32, ahead>;
    var own: array<f32, held>;  // belief without what came the other way, of the pixel that sends
    let first = pixel_of(0u, line, is_back) * number;
    for (var h = 0u; h < held; h++) {  // unrolled
        let k = h * 64u + local;
        if (k < number) {
            own[h] = beliefs[first + k] - select(messages_back[first + k], messages_ahead[first + k], is_back);
        }
    }
    for (var j = 0u; j < ahead; j++) {  // unrolled
        let pixel = pixel_of(j + 1u, line, is_back);
        penalties[j] = links[link_plane + min(pixel, pixel_of(j, line, is_back))];
        for (var h = 0u; h < held; h++) {  // unrolled
            let k = h * 64u + local;
            if (k < number) {
                let at = pixel * number + k;
                beliefs_read[j * held + h] = beliefs[at];
                sent_read[j * held + h] = select(messages_ahead[at], messages_back[at], is_back);
                returned_read[j * held + h] = select(messages_back[at], messages_ahead[at], is_back);
            }
        }
    }
    for (var s0 = 0u; s0 < length - 1u; s0 += ahead) {
        for (var j = 0u; j < ahead; j++) {  // unrolled
            let s = s0 + j;
            if (s >= length - 1u) { break; }
            let receives = pixel_of(s + 1u, line, is_back) * number;
            let later = pixel_of(s + 1u + ahead, line, is_back);
            var least = 1.0e30;
            for (var h = 0u; h < held; h++) {  // unrolled
                if (h * 64u + local < number) { least = min(least, own[h]); }
            }
            least = least_of_all(least, local, s);
            let penalty = penalties[j];
            penalties[j] = links[link_plane + min(later, pixel_of(s + ahead, line, is_back))];
            for (var h = 0u; h < held; h++) {  // unrolled
                let k = h * 64u + local;
                if (k < number) {
                    let message = min(own[h] - least, penalty);
                    let belief = beliefs_read[j * held + h] + (message - sent_read[j * held + h]);
                    own[h] = belief - returned_read[j * held + h];
                    let at = later * number + k;
                    beliefs_read[j * held + h] = beliefs[at];
                    sent_read[j * held + h] = select(messages_ahead[at], messages_back[at], is_back);
                    returned_read[j * held + h] = select(messages_back[at], messages_ahead[at], is_back);
                    beliefs[receives + k] = belief;
                    if (is_back) {
                        messages_back[receives + k] = message;
                    } else {
                        messages_ahead[receives + k] = message;
                    }
                }
            }
        }
    }
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    walk(group.x, local, false);
    walk(group.x, local, true);
}
