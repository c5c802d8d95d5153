// What a viewer sees while no picture comes: a frozen view must not pass for a live one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace lcdm {

// "no signal, last frame 12 s ago"; without the age when it is negative: there was none yet.
std::string no_signal_text(std::int64_t age_ns);

// The picture shown last (a JPEG; empty: none yet) without its colours and darker, with the text
// across it, as a JPEG. Empty where it cannot be made.
std::vector<std::byte> no_signal_jpeg(std::span<const std::byte> last, std::int64_t age_ns);

}  // namespace lcdm
