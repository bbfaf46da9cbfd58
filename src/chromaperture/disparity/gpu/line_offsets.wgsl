// How many lines the workgroups before have. One workgroup.

@group(0) @binding(0) var<storage, read_write> counts: array<u32>;  // (parts,): of workgroups; then of those before
@group(0) @binding(1) var<storage, read_write> numbers: array<u32>;  // lines, at most `most`; parts of groups, 0 at first
@group(0) @binding(2) var<storage, read_write> unfinished: array<u32>;

var<workgroup> sums: array<u32, 64>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) local: u32) {
    let each = (parts + 63u) / 64u;
    let first = local * each;
    let end = min(first + each, parts);
    var own = 0u;
    for (var k = first; k < end; k++) { own += counts[k]; }
    sums[local] = own;
    workgroupBarrier();
    var before = 0u;
    for (var other = 0u; other < local; other++) { before += sums[other]; }
    if (local == 63u) {
        numbers[0] = min(before + own, most);
        numbers[1] = 0u;
        if (before + own > most) { unfinished[0]++; }
    }
    for (var k = first; k < end; k++) {
        let here = counts[k];
        counts[k] = before;
        before += here;
    }
}
