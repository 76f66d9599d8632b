// A history that is called off in the middle of its work stands where it was.
#pragma once

#include "ctr/history.hpp"

namespace ctr {

template <class Work>
auto History::put_back_if_interrupted(const Work& work) {
    if (status_ == Status::failed) return work();  // stands nowhere
    const State before = save();
    try {
        return work();
    } catch (...) {
        restore(before);
        throw;
    }
}

}  // namespace ctr
