// Value of the nearest known pixel at every unknown one, 0 where none is known: the second half of
// `color/nearest_known.py`. Of pixels at one distance the first from the left counts, as there.

@group(0) @binding(0) var<storage, read> values: array<u32>;  // (H, W), NaN unknown
@group(0) @binding(1) var<storage, read> rows: array<i32>;  // (H, W): of the nearest known pixel in the column
@group(0) @binding(2) var<storage, read_write> filled: array<f32>;  // (H, W)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    if (values[i] != NAN_BITS) {
        filled[i] = bitcast<f32>(values[i]);
        return;
    }
    let x = i32(i % width);
    let y = i32(i / width);
    var least = 0x7fffffffi;  // squared distance
    var source = -1i;
    for (var reach = 0i; reach < i32(width) && reach * reach <= least; reach++) {
        for (var side = -1i; side <= 1i; side += 2i) {
            let column = x + side * reach;
            if (column < 0i || column >= i32(width)) { continue; }
            let row = rows[y * i32(width) + column];
            if (row < 0i) { continue; }
            let distance = reach * reach + (row - y) * (row - y);
            if (distance < least || (distance == least && side < 0i)) {
                least = distance;
                source = row * i32(width) + column;
            }
        }
    }
    filled[i] = select(0.0, bitcast<f32>(values[u32(max(source, 0i))]), source >= 0i);
}
