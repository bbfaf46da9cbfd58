// The factor that brings a guide to units of guide_range: its 1st and 99th percentile over a sparse grid.
// One workgroup finds the values of the four ranks by their bits, eight at a time (radix selection): all four in one walk
// over the samples, which are read `at_once` at a time, as one after the other waits for the memory.

@group(0) @binding(0) var<storage, read> planes: array<f32>;
@group(0) @binding(1) var<storage, read_write> stats: array<f32>;

var<workgroup> counts: array<atomic<u32>, 1024>;  // of the four ranks, one after the other
var<workgroup> prefixes: array<u32, 4>;  // bits found so far
var<workgroup> ranks_left: array<u32, 4>;  // among the values that begin with them
var<workgroup> homes: array<u32, 4>;  // first rank whose value begins with the same bits: it counts for all of them

// Floats in the order of unsigned integers.
fn ordered(value: f32) -> u32 {
    let bits = bitcast<u32>(value);
    return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn value_of(ordered_bits: u32) -> f32 {
    return bitcast<f32>(select(~ordered_bits, ordered_bits & 0x7fffffffu, (ordered_bits & 0x80000000u) != 0u));
}

fn sample(i: u32) -> u32 {
    return ordered(planes[first + (i / sparse_width) * sparse * width + (i % sparse_width) * sparse]);
}

fn percentile(place: f32, rank: u32) -> f32 {
    let low = value_of(prefixes[rank]);
    return low + (place - floor(place)) * (value_of(prefixes[rank + 1u]) - low);
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    if (local < 4u) {
        let below = u32(floor(select(low_place, high_place, local > 1u)));
        prefixes[local] = 0u;
        homes[local] = 0u;
        ranks_left[local] = min(below + (local & 1u), sparse_count - 1u);
    }
    for (var shift = 24i; shift >= 0i; shift -= 8i) {
        for (var rank = 0u; rank < 4u; rank++) { atomicStore(&counts[rank * 256u + local], 0u); }
        workgroupBarrier();
        for (var i = local; i < sparse_count; i += 256u * at_once) {
            var bits: array<u32, at_once>;
            for (var n = 0u; n < at_once; n++) {  // unrolled
                bits[n] = sample(min(i + n * 256u, sparse_count - 1u));
            }
            for (var n = 0u; n < at_once; n++) {  // unrolled
                for (var rank = 0u; rank < 4u; rank++) {
                    let same = shift == 24i || (bits[n] >> u32(shift + 8i)) == (prefixes[rank] >> u32(shift + 8i));
                    if (same && homes[rank] == rank && i + n * 256u < sparse_count) {
                        atomicAdd(&counts[rank * 256u + ((bits[n] >> u32(shift)) & 255u)], 1u);
                    }
                }
            }
        }
        workgroupBarrier();
        if (local < 4u) {
            var left = ranks_left[local];
            var digit = 0u;
            for (; digit < 255u; digit++) {
                let here = atomicLoad(&counts[homes[local] * 256u + digit]);
                if (left < here) { break; }
                left -= here;
            }
            ranks_left[local] = left;
            prefixes[local] |= digit << u32(shift);
        }
        workgroupBarrier();
        if (local < 4u) {
            var home = 0u;
            while (prefixes[home] != prefixes[local]) { home++; }
            homes[local] = home;
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        let low = percentile(low_place, 0u);
        let high = percentile(high_place, 2u);
        stats[GUIDE_SCALE + slot] = 1.0 / (max(high - low, 1.0e-6) * guide_range);  // 1e-6: an even guide
    }
}
