// Sums over a workgroup, for `variance.wgsl` and `variance_sum.wgsl`.

struct Sums {
    values: vec3f,
    squares: vec3f,
}

var<workgroup> sums: array<Sums, 256>;

fn summed(own: Sums, local: u32) -> Sums {
    sums[local] = own;
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (local < reach) {
            sums[local].values += sums[local + reach].values;
            sums[local].squares += sums[local + reach].squares;
        }
    }
    workgroupBarrier();
    return sums[0];
}
