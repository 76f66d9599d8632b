// The kernels for every x86-64 (or any other architecture).
#include "ctr/kernel.hpp"

namespace ctr {
namespace {
#include "kernel/body.hpp"
}
const KernelTable& baseline_kernel(int lanes) { return lanes == 1 ? table_of<double> : table_of<V4>; }
}  // namespace ctr
