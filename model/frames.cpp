#include "model/frames.h"

namespace lcdm::model {

bool amid_a_sequence(const Frames& frames, std::size_t index) {
  if (index == 0 || index + 1 >= frames.size()) return false;
  const std::string sequence = sequence_of(frames.name(index));
  return sequence_of(frames.name(index - 1)) == sequence &&
         sequence_of(frames.name(index + 1)) == sequence;
}

bool Frames::has_neighbours(std::size_t /*index*/) const { return false; }

Result<cv::Mat> Frames::neighbour(std::size_t index, int /*offset*/) const {
  return Status::error(StatusCode::kNotFound, "%s has no neighbours in time", name(index).c_str());
}

bool MemoryFrames::has_neighbours(std::size_t index) const {
  return video_ && amid_a_sequence(*this, index);
}

Result<PackFrame> MemoryFrames::read(std::size_t index) const {
  const auto why = unreadable_.find(index);
  if (why != unreadable_.end()) return why->second;
  return frames_[index];
}

Result<cv::Mat> MemoryFrames::neighbour(std::size_t index, int offset) const {
  const Result<PackFrame> frame = read(index + static_cast<std::size_t>(offset));
  if (!frame) return frame.status();
  return frame->rgb;
}

JoinedFrames::Place JoinedFrames::place_of(std::size_t index) const {
  if (index < first_->size()) return {*first_, index};
  return {*second_, index - first_->size()};
}

std::string JoinedFrames::name(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.name(place.index);
}

Result<PackFrame> JoinedFrames::read(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.read(place.index);
}

bool JoinedFrames::has_neighbours(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.has_neighbours(place.index);
}

Result<cv::Mat> JoinedFrames::neighbour(std::size_t index, int offset) const {
  const Place place = place_of(index);
  return place.frames.neighbour(place.index, offset);
}

std::string sequence_of(const std::string& name) {
  const std::size_t end = name.find('_');
  return end == std::string::npos ? "" : name.substr(0, end);
}

}  // namespace lcdm::model
