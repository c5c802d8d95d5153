#include "model/frames.h"

namespace lcdm::model {

bool MemoryFrames::has_neighbours(std::size_t index) const {
  if (!video_ || index == 0 || index + 1 >= frames_.size()) return false;
  const std::string sequence = sequence_of(frames_[index].name);
  return sequence_of(frames_[index - 1].name) == sequence &&
         sequence_of(frames_[index + 1].name) == sequence;
}

Result<cv::Mat> MemoryFrames::neighbour(std::size_t index, int offset) const {
  return frames_[index + static_cast<std::size_t>(offset)].rgb;
}

std::string sequence_of(const std::string& name) {
  const std::size_t end = name.find('_');
  return end == std::string::npos ? "" : name.substr(0, end);
}

}  // namespace lcdm::model
