// Starts an encoder from weights that others trained on ImageNet, under the names they gave them.
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/network.h"
#include "model/pose_net.h"
#include "model/safetensors.h"

namespace lcdm::model {

struct ImportReport {
  std::size_t taken = 0;  // tensors of the network found in the file
  std::vector<std::string>
      unused;  // tensors of the file that have no place, such as a classifier's
};

enum class ChannelOrder : std::uint8_t { kRgb, kBgr };

// MobileViT by timm's names (`stages.2.1.conv_kxk.conv.weight`) or ml-cvnets'
// (`layer_3.1.local_rep.conv_3x3.block.conv.weight`). `order` is that of the pictures it was
// trained on: the first convolution is turned round for kBgr. kInvalidInput where a tensor of the
// network is missing from the file or has another shape, naming the first; the network is then as
// before.
Result<ImportReport> import_mobilevit(const TensorFile& file, ChannelOrder order,
                                      MobileVit& encoder);

// ResNet18 by torchvision's names. Where the network takes two pictures at once, each gets half of
// the first convolution (Monodepth2). Errors as above.
Result<ImportReport> import_resnet18(const TensorFile& file, ResNet18& encoder);

}  // namespace lcdm::model
