// The least of a line's choices, which 64 invocations share, through shared memory.
const lanes = 64u;

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
