// Writes the points of every plane's part one after the other, row by row. A workgroup has one plane, an invocation
// blocks that follow one another.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w): plane of every block
@group(0) @binding(1) var<storage, read> cores: array<u32>;  // (h, w): 1 in a core
@group(0) @binding(2) var<storage, read> counts: array<vec2u>;  // (capacity,): all blocks, core
@group(0) @binding(3) var<storage, read> segments: array<vec4u>;  // (capacity,): first point, points
@group(0) @binding(4) var<storage, read_write> points: array<u32>;  // x and y, 16 bits each

var<workgroup> sums: array<u32, 64>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let number = segments[group.x].y;
    if (number == 0u) { return; }
    let takes_all = number == counts[group.x].x;
    let each = (width * height + 63u) / 64u;
    let first = local * each;
    let end = min(first + each, width * height);
    var own = 0u;
    for (var i = first; i < end; i++) { own += select(0u, 1u, choice[i] == group.x && (takes_all || cores[i] == 1u)); }
    sums[local] = own;
    workgroupBarrier();
    if (own == 0u) { return; }
    var at = segments[group.x].x;
    for (var other = 0u; other < local; other++) { at += sums[other]; }
    for (var i = first; i < end; i++) {
        if (choice[i] == group.x && (takes_all || cores[i] == 1u)) {
            points[at] = (i % width) | ((i / width) << 16u);
            at++;
        }
    }
}
