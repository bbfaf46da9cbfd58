// Adds 1 to a number: dispatches that are repeated find out which repetition they are.

@group(0) @binding(0) var<storage, read_write> number: array<u32>;

@compute @workgroup_size(1)
fn main() {
    number[0] = select(number[0] + 1u, 0u, to_zero);
}
