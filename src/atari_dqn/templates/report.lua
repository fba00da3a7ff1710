-- Divisions that CSS styles on the page, for paper: badges, what is still absent, the row of cards.
if FORMAT ~= "typst" then return {} end

local function wrapped(open, blocks, close)
  local result = { pandoc.RawBlock("typst", open) }
  for _, block in ipairs(blocks) do table.insert(result, block) end
  table.insert(result, pandoc.RawBlock("typst", close))
  return result
end

function Div(div)
  if div.classes:includes("badge") then
    return wrapped("#badge[", div.content, "]")
  elseif div.classes:includes("absent") then
    return wrapped("#absent[", div.content, "] <" .. div.identifier .. ">")
  elseif div.classes:includes("card") then
    local result = { pandoc.RawBlock("typst", "#cards(") }
    for _, cell in ipairs(div.content) do
      for _, block in ipairs(wrapped("[", cell.content, "],")) do table.insert(result, block) end
    end
    table.insert(result, pandoc.RawBlock("typst", ")"))
    return result
  end
end
