#include "../../messages.hpp"
