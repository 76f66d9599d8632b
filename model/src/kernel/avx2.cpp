// The kernels for CPUs with AVX2 and FMA; compiled with -mavx2 -mfma, called only after the CPU was asked.
#include "ctr/kernel.hpp"

namespace ctr {
namespace {
#include "kernel/body.hpp"
}
const KernelTable& avx2_kernel(int lanes) { return lanes == 1 ? table_of<double> : table_of<V4>; }
}  // namespace ctr
