// Replace unusable pixels of the halved views by the mean of the usable ones around: their edges would outweigh all
// texture. The plane behind the guide holds the usable share of each pixel, of which the mask is made.

@group(0) @binding(0) var<storage, read> around: array<f32>;  // (K + 2, h, w), blurred where there are unusable pixels
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;  // (K + 2, h, w): views, guide, usable share
@group(0) @binding(3) var<storage, read_write> smoothed: array<f32>;  // (K + 2, h, w), of which only the mask

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= plane) { return; }
    let share = (view_count + 1u) * plane + i;
    let usable = planes[share] > usable_share;
    if (!usable) {
        for (var k = 0u; k < view_count; k++) {
            let mean = around[k * plane + i] / (around[share] + 1.0e-3);  // 1e-3: no division by 0
            planes[k * plane + i] = fill_units * stats[UNIT] * round(stats[UNIT + 1u] * mean / fill_units);
        }
    }
    smoothed[share] = select(0.0, 1.0, usable);
}
