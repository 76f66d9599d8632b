// The kernel for eight lanes on CPUs with AVX-512; compiled for those, called only after the CPU was asked.
#include "ctr/kernel.hpp"

namespace ctr {
namespace {
#include "kernel/body.hpp"
typedef double V8 __attribute__((vector_size(64)));
}  // namespace
const KernelTable& avx512_kernel() { return table_of<V8>; }
}  // namespace ctr
