// Sums over a workgroup, for `light.wgsl` and `light_sum.wgsl`.

var<workgroup> sums: array<vec4f, 256>;

fn summed(own: vec4f, local: u32) -> vec4f {
    sums[local] = own;
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (local < reach) { sums[local] += sums[local + reach]; }
    }
    workgroupBarrier();
    return sums[0];
}
